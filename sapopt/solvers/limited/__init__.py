"""Plans of problems with capacities, idleness, limits and teams."""
