"""States that are not an agent's own."""
