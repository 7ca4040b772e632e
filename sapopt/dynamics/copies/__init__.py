"""Agents and tasks that are copies of one another."""
