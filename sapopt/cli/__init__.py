"""The ``sapopt`` program."""

from sapopt.cli import (  # they add their commands to the app
    exporting,
    proving,
    reporting,
    solving,
    sweeping,
    training,
    warming,
)
from sapopt.cli.app import app
from sapopt.running.streams import forgive

__all__ = ["app", "exporting", "main", "proving", "reporting", "solving", "sweeping", "training", "warming"]


def main() -> None:
    """Run the ``sapopt`` program."""
    forgive()
    app()
