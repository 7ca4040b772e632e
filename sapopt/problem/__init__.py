"""The sequential assignment problem, and what a solver returns for it."""
