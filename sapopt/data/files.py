"""The one way in which files are written, and arrays with plain values read back.

Written: into a new file of a unique name in the same folder, flushed to the disk, then renamed. So whatever happens
(a full disk, a killed process, two writers at once), the name holds the old content or the new one, whole. A link at
that name is replaced, never followed.

Read: names, sizes, shapes and types of all arrays are known before anything is unpacked, and what is larger than the
reader's limit is refused, so a small file cannot fill the memory.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEADER_BYTES = 256 * 2**20
"""Most bytes of a file's header with its plain values (four a letter); a trace of 100 000 steps takes a tenth."""


@contextmanager
def replacing(path: str | Path) -> Iterator[IO[bytes]]:
    """A binary file to write to, which takes its name when the block has ended well and else leaves no trace.

    Parameters
    ----------
    path : str or Path
        The name; an old file there stays as it is until then.

    Raises
    ------
    OSError
        If the file cannot be written, with `path` as its file name.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} exists and is not a file")
    part = path.parent / f".sapopt-{secrets.token_hex(8)}.part"
    try:
        # Exclusive: neither a file nor a link of that name is there. Permissions are those of any new file.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | (os.O_BINARY if hasattr(os, "O_BINARY") else 0)
        with os.fdopen(os.open(part, flags, 0o666), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from None
    finally:
        with suppress(OSError):
            part.unlink()


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, all or nothing."""
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def write_figure(path: str | Path, figure: Figure, dpi: float = 150) -> None:
    """Write a figure of matplotlib as PNG, all or nothing."""
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=dpi)


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as one compressed ``.npz``, all or nothing; equal arrays make equal files."""
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(name + ".npy", (1980, 1, 1, 0, 0, 0))  # not the time of day
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def write_npz(path: str | Path, meta: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Write a dictionary of plain values and some arrays as one compressed ``.npz``, all or nothing."""
    # The names are listed, because a changed byte in the zip directory can make an array vanish without a trace.
    text = json.dumps(meta | {"arrays": sorted(arrays)}, default=_plain)
    write_arrays(path, {"meta": np.array(text), **arrays})


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written to a file")


@dataclass(frozen=True)
class Entry:
    """What an array of a file must be.

    Attributes
    ----------
    kinds : str
        Allowed kinds of numbers: letters of `numpy.dtype.kind`.
    shape : tuple of int or None
        The length along every axis, None for any; a single None for any shape.
    optional : bool
        Whether the array may be missing.
    """

    kinds: str
    shape: tuple[int | None, ...] | None = None
    optional: bool = False

    def refusal(self, dtype: np.dtype, shape: tuple[int, ...]) -> str:
        """Why an array is not what it must be; empty if it is."""
        if dtype.kind not in self.kinds:
            return f"holds {dtype}"
        if self.shape is None:
            return ""
        fits = len(shape) == len(self.shape) and all(
            want in (None, length) for want, length in zip(self.shape, shape, strict=True)
        )
        return "" if fits else f"has shape {shape}"


# What zipfile, numpy and json raise on changed bytes; a RuntimeError for flags such as encryption or a deep nesting.
_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    SyntaxError,
    MemoryError,
    OverflowError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(
    path: str | Path,
    form: str,
    entries: Mapping[str, Entry],
    most_bytes: int,
    prefix: str | tuple[str, ...] | None = None,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read what `write_npz` wrote.

    Parameters
    ----------
    path : str or Path
    form : str
        The expected name of the format.
    entries : mapping of str to Entry
        The arrays that the file may hold, and must where they are not optional.
    most_bytes : int
        Most memory that the arrays may take together; larger files are refused before they are unpacked.
    prefix : str or tuple of str, optional
        Arrays of numbers whose names begin like this are allowed besides.

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is truncated, changed, too large, or of another format.
    """
    try:
        with open(path, "rb") as handle, zipfile.ZipFile(handle) as archive:
            members = _members(archive)
            meta = _read_header(archive, members)
            if meta.get("format") == form:
                names = members.keys() - {"meta"}
                if meta.pop("arrays", None) != sorted(names):
                    raise ValueError("some of its arrays are missing")
                _check(archive, members, names, entries, most_bytes, prefix)
                return meta, {name: _read_array(archive, members[name]) for name in sorted(names)}
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f"{path}: damaged or not a sapopt file ({reason})") from None
    raise ValueError(f"{path}: holds {meta.get('format', 'something else')!r}, expected {form!r}")


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The arrays of an archive by name, none of them twice and nothing else."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name == info.filename or name in members:
            raise ValueError(f"it holds {info.filename!r}, which does not belong there")
        members[name] = info
    if "meta" not in members:
        raise ValueError("it has no sapopt header")
    return members


def _read_header(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]) -> dict[str, Any]:
    if members["meta"].file_size > _HEADER_BYTES:
        raise ValueError(f"its header is larger than {_HEADER_BYTES // 2**20} MiB")
    dtype, shape = _described(archive, members["meta"])
    if dtype.kind != "U" or shape != ():
        raise ValueError("its header is not readable")
    meta = json.loads(str(_read_array(archive, members["meta"])))
    if not isinstance(meta, dict):
        raise ValueError("its header is not readable")
    return meta


def _check(
    archive: zipfile.ZipFile,
    members: dict[str, zipfile.ZipInfo],
    names: set[str],
    entries: Mapping[str, Entry],
    most_bytes: int,
    prefix: str | tuple[str, ...] | None,
) -> None:
    """Check all arrays by what is said about them, before one is unpacked."""
    for name, entry in entries.items():
        if name not in names and not entry.optional:
            raise ValueError(f"the array {name!r} is missing")
    total = sum(members[name].file_size for name in names)
    if total > most_bytes:
        raise ValueError(f"its arrays take {total / 2**20:.0f} MiB, more than {most_bytes // 2**20} MiB")
    for name in sorted(names):
        known = entries.get(name)
        if known is None and (prefix is None or not name.startswith(prefix)):
            raise ValueError(f"it holds {name!r}, which does not belong there")
        reason = (known or Entry("biuf")).refusal(*_described(archive, members[name]))
        if reason:
            raise ValueError(f"the array {name!r} {reason}")


def _described(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> tuple[np.dtype, tuple[int, ...]]:
    """Type and shape of an array, which must account for every byte that is said to follow."""
    with archive.open(info) as stream:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
        else:
            raise ValueError(f"an array has format {version}")
        left = info.file_size - stream.tell()
    if dtype.hasobject or min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != left:
        raise ValueError(f"{info.filename} is not as large as it says")
    return dtype, shape


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as stream:
        array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
        stream.read(1)  # the end: there the archive compares the checksum
    return array
