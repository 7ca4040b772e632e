"""The ``sapopt`` program."""

from sapopt.cli import proving, reporting, solving, sweeping, training  # they add their commands to the app
from sapopt.cli.app import app

__all__ = ["app", "main", "proving", "reporting", "solving", "sweeping", "training"]


def main() -> None:
    """Run the ``sapopt`` program."""
    app()
