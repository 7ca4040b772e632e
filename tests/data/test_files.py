"""Files: old or new content, never neither, whatever happens to the writer; nothing unpacked before it is checked."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sapopt
from sapopt import SAP, Result, solve
from sapopt.data.files import Entry, read_npz, replacing, write_npz, write_text
from sapopt.proofs.certificate import Certificate, CertificateError
from sapopt.solvers import HAA

ROOT = Path(sapopt.__file__).parents[1]
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
PROBLEM = SAP(np.random.default_rng(0).random((40, 6, 9)), 0.4)


def test_two_writers_at_once(tmp_path: Path) -> None:
    """Writers do not get in each other's way; one of the contents is there in the end, whole, and nothing else."""
    path = tmp_path / "p.npz"
    failed: list[BaseException] = []

    def write(size: int) -> None:
        try:
            for _ in range(20):
                write_npz(path, {"format": "f", "size": size}, {"values": np.full(size, 1.0)})
        except BaseException as error:
            failed.append(error)

    writers = [threading.Thread(target=write, args=(size,)) for size in (10, 1000, 50_000)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert not failed
    meta, arrays = read_npz(path, "f", {"values": Entry("f", (None,))}, 10**6)
    assert arrays["values"].shape == (meta["size"],)
    assert [p.name for p in tmp_path.iterdir()] == ["p.npz"]


@POSIX
def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    """Folders, devices and pipes are refused, and a folder that is not there is named."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, Path("/dev/null"), tmp_path / "pipe"):
        with pytest.raises(OSError, match="not a file"):
            PROBLEM.save(path)
    with pytest.raises(FileNotFoundError, match="missing"):
        PROBLEM.save(tmp_path / "missing" / "p.npz")


@POSIX
def test_permissions_are_those_of_any_new_file(tmp_path: Path) -> None:
    """The file is as readable for others as one that is written by hand."""
    (tmp_path / "by hand").write_text("x")
    write_text(tmp_path / "ours", "x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "by hand").stat().st_mode


def test_an_error_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    """Whatever ends the block, Ctrl-C included, the name keeps what it had."""
    write_text(tmp_path / "x", "old")

    def fail(error: type[BaseException]) -> None:
        with replacing(tmp_path / "x") as file:
            file.write(b"half")
            raise error

    for error in (ValueError, KeyboardInterrupt, OSError):
        with pytest.raises(error):
            fail(error)
    assert (tmp_path / "x").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


HEADER = {"format": "f", "arrays": ["values"]}


def npy(array: np.ndarray) -> bytes:
    """The bytes of a ``.npy`` file."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def archive(path: Path, members: list[tuple[str, bytes]]) -> Path:
    """A zip file of just these members."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members:
            file.writestr(name, content)
    return path


META = ("meta.npy", npy(np.array(json.dumps(HEADER))))
LYING = npy(np.zeros(4)).replace(b"(4,), }", b"(9999,), }".ljust(7))
DAMAGED: dict[str, tuple[list[tuple[str, bytes]], str]] = {
    "a raw entry": ([META, ("values", b"abc")], "does not belong there"),
    "another name": ([META, ("values.npy", npy(np.zeros(3))), ("x/../../y.npy", npy(np.zeros(3)))], "missing"),
    "no array": ([META, ("values.npy", b"")], "damaged"),
    "a lying header": ([META, ("values.npy", LYING)], "not as large as it says"),
    "words": ([META, ("values.npy", npy(np.array(["a", "b"])))], "'values' holds <U1"),
    "two axes": ([META, ("values.npy", npy(np.zeros((2, 2))))], r"'values' has shape \(2, 2\)"),
    "too large": ([META, ("values.npy", npy(np.zeros(300_000)))], "2 MiB, more than 1 MiB"),
    "no header": ([("values.npy", npy(np.zeros(3)))], "no sapopt header"),
    "a header of numbers": ([("meta.npy", npy(np.zeros(3))), ("values.npy", npy(np.zeros(3)))], "not readable"),
    "a nested header": (
        [("meta.npy", npy(np.array("[" * 100_000))), ("values.npy", npy(np.zeros(3)))], "damaged or not",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_told(tmp_path: Path, name: str) -> None:
    """Every kind of wrong content is one ValueError that names the file."""
    members, message = DAMAGED[name]
    path = archive(tmp_path / "p.npz", members)
    with pytest.raises(ValueError, match=rf"p\.npz: .*{message}"):
        read_npz(path, "f", {"values": Entry("f", (None,))}, 2**20)


def test_a_bomb_is_refused_before_it_goes_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small file of large arrays is refused by its sizes: no array of it is ever read."""
    path = tmp_path / "bomb.npz"
    meta = {"format": "sapopt-certificate-1"}
    write_npz(path, meta, {"plan": np.zeros((1, 1), np.int64), "prices": np.zeros((9000, 9000))})
    assert path.stat().st_size < 10**6
    read: list[str] = []
    original = sapopt.data.files._read_array

    def watched(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
        read.append(info.filename)
        return original(archive, info)

    monkeypatch.setattr("sapopt.data.files._read_array", watched)
    with pytest.raises(CertificateError, match="618 MiB, more than 512 MiB"):
        Certificate.load(path)
    write_npz(path, meta, {"plan": np.zeros((1, 1), np.int64), "prices": np.zeros((40, 90))})
    with pytest.raises(CertificateError, match=r"'plan' has shape \(1, 1\)"):
        sapopt.verify(path, PROBLEM)
    assert read == ["meta.npy"] * 2


FIELDS: dict[str, tuple[Any, str]] = {
    "value": ("x", "value is 'x', not a number"),
    "bound": (float("nan"), "bound is nan"),
    "runtime": (None, "runtime is None"),
    "trace": ({"a": 1}, "trace is not a list"),
    "seed": (1.5, "seed is 1.5"),
    "handovers": ("3", "handovers is '3'"),
    "solver": (7, "solver is 7"),
    "status": ([], "damaged result"),
}


@pytest.mark.parametrize("name", FIELDS)
def test_fields_of_a_result_are_checked(tmp_path: Path, name: str) -> None:
    """A result with a field of a wrong type is refused when it is read, and says which."""
    path = tmp_path / "r.npz"
    solve(PROBLEM, HAA()).save(path)
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    value, message = FIELDS[name]
    meta = json.loads(str(arrays.pop("meta"))) | {name: value}
    del meta["arrays"]
    write_npz(path, meta, arrays)
    with pytest.raises(ValueError, match=message):
        Result.load(path)
