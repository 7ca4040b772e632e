"""The log of a training run: a CSV file always, TensorBoard files where it is installed."""

from __future__ import annotations

import csv
import io
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from sapopt.data.files import write_text

COLUMNS = ("episode", "steps", "gradient_steps", "epsilon", "value", "loss", "evaluation", "seconds")
_EVERY_SECONDS = 2.0
"""Between two times that the file is written while rows come in."""


class TrainingLog:
    """Rows of ``log.csv``, and the same numbers for TensorBoard if it can be imported.

    The file is written as a whole, as every file of sapopt is, some seconds apart and at the end; who follows it wants
    ``tail -F``. TensorBoard writes its own files in its own way.

    Parameters
    ----------
    folder : Path
    episode : int
        Rows after this episode belong to a run that was killed before its checkpoint; they are dropped.
    """

    def __init__(self, folder: Path, episode: int = 0) -> None:
        self._path = folder / "log.csv"
        self._text = io.StringIO(newline="")
        self._writer = csv.DictWriter(self._text, COLUMNS)
        self._writer.writeheader()
        if self._path.exists() and episode:
            with self._path.open(newline="") as file:
                self._writer.writerows(row for row in csv.DictReader(file) if int(row["episode"]) <= episode)
        self.save()
        self._board = _board(folder)

    def write(self, row: dict[str, Any]) -> None:
        """Append one row."""
        self._writer.writerow(
            {key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()}
        )
        if time.monotonic() - self._saved > _EVERY_SECONDS:
            self.save()
        if self._board is not None:
            for key in COLUMNS[3:]:
                if key in row:
                    self._board.add_scalar(key, row[key], row["steps"])

    def save(self) -> None:
        """Write the file; to be called before a checkpoint, which must not know of more than the log does."""
        write_text(self._path, self._text.getvalue())
        self._saved = time.monotonic()

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._board is not None:
            self._board.close()
        if error is None:
            self.save()
        else:
            with suppress(OSError):  # the error at hand is the one to tell
                self.save()


def _board(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder / "tensorboard"))
