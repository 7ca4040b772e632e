"""The ``sapopt`` program."""

from sapopt.cli.app import app, main

__all__ = ["app", "main"]
