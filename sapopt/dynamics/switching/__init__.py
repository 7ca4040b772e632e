"""Changing task costs: the previous assignment is the state."""
