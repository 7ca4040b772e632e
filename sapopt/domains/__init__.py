"""Problems from practice: what builds benefits, dynamics and graphs from the data of a domain."""
