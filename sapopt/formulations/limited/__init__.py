"""Problems with capacities, limits and teams: their graph of paths, its Lagrangian dual, and its programme."""
