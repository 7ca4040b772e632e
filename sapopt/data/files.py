"""How arrays and plain values are written to one file, and read back."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np


def write_npz(path: str | Path, meta: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Write a dictionary of plain values and some arrays as one compressed ``.npz``, all or nothing."""
    path = Path(path)
    temporary = path.with_name(path.name + ".part")
    # The names are listed, because a changed byte in the zip directory can make an array vanish without a trace.
    text = json.dumps(meta | {"arrays": sorted(arrays)}, default=_plain)
    try:
        with temporary.open("wb") as file:
            _write_zip(file, {"meta": np.array(text), **arrays})
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _write_zip(file: IO[bytes], arrays: dict[str, Any]) -> None:
    """`numpy.savez_compressed` without the time of day: equal content makes equal files."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(name + ".npy", (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written to a file")


# What numpy, zipfile and json raise on changed bytes; a RuntimeError for flags such as encryption or a deep nesting.
_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    SyntaxError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(path: str | Path, form: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read what `write_npz` wrote; `form` is the expected format name.

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is truncated, changed, or of another format.
    """
    try:
        # numpy leaves a file that it cannot read open, so the handle is ours.
        with open(path, "rb") as handle:
            file = np.load(handle, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("it is no .npz file")
            if "meta" not in file.files:
                raise ValueError("it has no sapopt header")
            arrays = {name: file[name] for name in file.files}
        meta = json.loads(str(arrays.pop("meta")))
        if not isinstance(meta, dict):
            raise ValueError("its header is not readable")
        if meta.pop("arrays", None) != sorted(arrays):
            raise ValueError("some of its arrays are missing")
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        raise ValueError(f"{path}: damaged or not a sapopt file ({error})") from None
    if meta.get("format") != form:
        raise ValueError(f"{path}: holds {meta.get('format', 'something else')!r}, expected {form!r}")
    return meta, arrays
