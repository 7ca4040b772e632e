"""Agents that run on batteries."""
