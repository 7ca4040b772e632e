"""What a command leaves behind: JSON on stdout, and files under ``--out``, none of which is overwritten by accident."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.files import write_figure, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_json(value: Any) -> str:
    """Strict JSON; numbers that JSON does not have (NaN, infinite) become null."""
    return json.dumps(_plain(value), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def check_new(path: Path, force: bool) -> None:
    """Raise ValueError if a file exists and may not be overwritten, or has no folder to lie in."""
    if path.is_dir():
        raise ValueError(f"{path} is a folder, not a file")
    if path.exists() and not force:
        raise ValueError(f"{path} exists already; give --force to overwrite it, or another --out")
    if not path.parent.is_dir():
        raise ValueError(f"there is no folder {path.parent}")


class Output:
    """The files of one command in one folder, or nothing without a folder.

    Parameters
    ----------
    folder : Path or None
    names : file names that the command is going to write
    force : overwrite existing files

    Raises
    ------
    ValueError
        Before any work is done: if a file exists and `force` is not given, or the folder cannot be written to.
    """

    def __init__(self, folder: Path | None, names: list[str], force: bool) -> None:
        self.folder = folder
        self.written: list[Path] = []
        if folder is None:
            return
        existing = [name for name in names if (folder / name).exists()]
        if existing and not force:
            raise ValueError(
                f"{folder / existing[0]} exists already; give --force to overwrite it, or another --out"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"--out {folder}: {error.strerror or error}") from None
        if not os.access(folder, os.W_OK):
            raise ValueError(f"--out {folder}: no permission to write there")

    def json(self, name: str, value: Any) -> None:
        """Write a JSON file."""
        if (path := self._path(name)) is not None:
            write_text(path, as_json(value) + "\n")

    def npz(self, name: str, save: Callable[[Path], object]) -> None:
        """Let `save` write an npz file."""
        if (path := self._path(name)) is not None:
            save(path)

    def png(self, name: str, figure: Figure) -> None:
        """Write a figure."""
        if (path := self._path(name)) is not None:
            write_figure(path, figure)

    def _path(self, name: str) -> Path | None:
        if self.folder is None:
            return None
        self.written.append(self.folder / name)
        return self.folder / name


def figure(width: float, height: float, rows: int = 1) -> tuple[Figure, Any]:
    """A figure with its axes that needs no window system (drawn by Agg when it is saved)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(drawing)
    return drawing, drawing.subplots(rows, 1)
