"""The log of a training run: a CSV file always, TensorBoard files where it is installed."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType
from typing import Any

COLUMNS = ("episode", "steps", "gradient_steps", "epsilon", "value", "loss", "evaluation", "seconds")


class TrainingLog:
    """Rows of ``log.csv``, and the same numbers for TensorBoard if it can be imported.

    Parameters
    ----------
    folder : Path
    episode : int
        Rows after this episode belong to a run that was killed before its checkpoint; they are dropped.
    """

    def __init__(self, folder: Path, episode: int = 0) -> None:
        self._path = folder / "log.csv"
        kept: list[dict[str, str]] = []
        if self._path.exists() and episode:
            with self._path.open(newline="") as file:
                kept = [row for row in csv.DictReader(file) if int(row["episode"]) <= episode]
        self._file = self._path.open("w", newline="")
        self._writer = csv.DictWriter(self._file, COLUMNS)
        self._writer.writeheader()
        self._writer.writerows(kept)
        self._board = _board(folder)

    def write(self, row: dict[str, Any]) -> None:
        """Append one row and flush it."""
        self._writer.writerow(
            {key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()}
        )
        self._file.flush()
        if self._board is not None:
            for key in COLUMNS[3:]:
                if key in row:
                    self._board.add_scalar(key, row[key], row["steps"])

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if self._board is not None:
            self._board.close()


def _board(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder / "tensorboard"))
