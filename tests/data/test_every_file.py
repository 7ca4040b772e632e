"""Every file that is written, one by one: a full disk, a killed writer, two at once, a link; no other way to write."""

from __future__ import annotations

import ast
import io
import json
import signal
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load
from written_files import KINDS, written

import sapopt

ROOT = Path(sapopt.__file__).parents[1]
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
ELSEWHERE = {
    ("sapopt/data/files.py", "the one place"),
    ("sapopt/running/streams.py", "opens the null device in place of a stream that is closed"),
}
"""Files that may open others to write, and why."""
WRITING = {
    "write_text", "write_bytes", "savefig", "save_file", "savetxt", "savez", "savez_compressed", "dump", "tofile",
    "to_csv", "to_parquet", "to_json", "touch",
}  # fmt: skip
"""Methods that write a file of their own."""


def writes(path: Path) -> Iterator[str]:
    """Calls in a file that write to the disk by themselves."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        said = f"line {node.lineno}: {ast.unparse(node)}"
        if isinstance(node.func, ast.Attribute) and name in WRITING:
            yield said
        if (
            isinstance(node.func, ast.Attribute)
            and name == "save"
            and ast.unparse(node.func.value) in {"np", "torch"}
        ):
            yield said
        if name in {"open", "fdopen"}:
            modes = [
                a.value
                for a in (*node.args, *(k.value for k in node.keywords))
                if isinstance(a, ast.Constant)
            ]
            if any(
                isinstance(mode, str) and set(mode) <= set("rwaxbt+U") and set(mode) & set("wax+")
                for mode in modes
            ):
                yield said


def test_there_is_one_way_to_write() -> None:
    """Nothing outside ``data/files.py`` opens a file to write, in the library, the experiments and the tools."""
    allowed = {name for name, _ in ELSEWHERE}
    found = {}
    for folder in ("sapopt", "experiments", "tools"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if name not in allowed and (calls := list(writes(path))):
                found[name] = calls
    assert found == {}


@pytest.mark.parametrize(
    "code",
    [
        "open(p, 'w')", "p.open('wb')", "open(p, mode='a')", "os.fdopen(f, 'r+')", "p.write_text('x')", "np.save(p, x)",
        "figure.savefig(p)", "json.dump(x, f)", "gzip.open(p, 'xb')",
    ],
)  # fmt: skip
def test_the_search_for_other_ways_finds_them(code: str, tmp_path: Path) -> None:
    """What the test above looks for is seen where it is."""
    (tmp_path / "x.py").write_text(f"{code}\nopen(p)\nwrite_text(p, 'w')\np.open('rb')\nload.save(p)\n")
    assert [call.partition(":")[0] for call in writes(tmp_path / "x.py")] == ["line 1"]


@pytest.fixture(scope="module")
def writers() -> dict[str, Callable[[Path], Any]]:
    """Made once."""
    return written()


def test_every_kind_is_tried(writers: dict[str, Callable[[Path], Any]]) -> None:
    """The list of names and the list of writers agree, and every module that writes stands behind one of them."""
    assert tuple(writers) == KINDS
    using = set()
    for path in (*(ROOT / "sapopt").rglob("*.py"), ROOT / "experiments" / "common.py"):
        names = {
            node.id
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Name)
        }
        if names & {"replacing", "write_text", "write_npz", "write_arrays", "write_figure"}:
            using.add(path.relative_to(ROOT).as_posix())
    assert using == {
        "sapopt/data/files.py",
        "sapopt/problem/files.py", "sapopt/live/saving.py", "sapopt/problem/result.py", "sapopt/proofs/certificate.py",
        "sapopt/exchange/files.py", "sapopt/exchange/programmes.py",
        "sapopt/exchange/czml.py", "sapopt/exchange/geojson.py",
        "sapopt/cli/output.py", "sapopt/cli/proving.py", "sapopt/cli/solving.py",  # prices, JSON, figures
        "sapopt/report/page.py", "sapopt/solvers/charge_value.py", "sapopt/formulations/qap.py",
        "sapopt/learning/network.py", "sapopt/learning/checkpoint.py", "sapopt/learning/resume.py",
        "sapopt/learning/logs.py", "sapopt/sweeps/engine.py", "experiments/common.py",
    }  # fmt: skip


PATHS = """
import sys
from pathlib import Path
sys.path[:0] = ["tests", "."]
from written_files import written
folder = Path(sys.argv[1])
made = written()
"""
FULL_DISK = (
    PATHS
    + """
import resource
for name, write in made.items():
    (folder / name).write_text("old")
resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
for name, write in made.items():
    try:
        write(folder / name)
    except OSError as error:
        print(name, Path(error.filename).name)
"""
)


@POSIX
@pytest.mark.skipif(sys.platform != "linux", reason="how a limit is told differs")
def test_a_full_disk_leaves_the_old_files(tmp_path: Path) -> None:
    """A write that fails names its file, leaves the old one as it was, and no other files behind."""
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    # The log begins with a short file and is full only later, so it leaves its own first line.
    assert done.stdout.split() == [word for kind in KINDS for word in (kind, kind)]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(KINDS)
    for kind in KINDS:
        text = (tmp_path / kind).read_text()
        assert text == "old" or (kind == "log.csv" and text.startswith("episode,") and text.endswith("\n"))


KILLED = (
    PATHS
    + """
for name, write in made.items():
    write(folder / "reference" / name)
for name in made:
    (folder / "live" / name).write_text("old")
print("\\nready", flush=True)
while True:
    for name, write in made.items():
        write(folder / "live" / name)
"""
)


@POSIX
def test_a_killed_writer_leaves_whole_files(tmp_path: Path) -> None:
    """A writer of all kinds that is killed at any moment leaves for every name the old content or the new one."""
    (tmp_path / "reference").mkdir()
    for delay in (0.02, 0.3, 0.9):
        live = tmp_path / "live"
        live.mkdir(exist_ok=True)
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        while process.stdout.readline() not in ("ready\n", ""):
            pass
        threading.Event().wait(delay)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        for kind in KINDS:
            assert is_whole(live / kind, tmp_path / "reference" / kind)


def unpacked(archive: bytes) -> dict[str, bytes]:
    """What is in an archive, but for the part that says when it was made."""
    with zipfile.ZipFile(io.BytesIO(archive)) as file:
        return {name: file.read(name) for name in file.namelist() if name != "docProps/core.xml"}


def is_whole(path: Path, reference: Path) -> bool:
    """Whether a file is the old one or like one that was written in peace."""
    content = path.read_bytes()
    if content == b"old":
        return True
    if path.name == "experiment.json":  # says when it was made
        return json.loads(content).keys() == json.loads(reference.read_bytes()).keys()
    if path.name == "log.csv":  # grows
        return reference.read_bytes().startswith(content) and content.endswith(b"\n")
    if path.name in ("weights", "checkpoint"):  # the order of their header is drawn by chance
        ours, theirs = load(content), load(reference.read_bytes())
        return ours.keys() == theirs.keys() and all(bool((ours[key] == theirs[key]).all()) for key in ours)
    if path.suffix == ".xlsx":  # the archive says when it was packed
        return unpacked(content) == unpacked(reference.read_bytes())
    return content == reference.read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_two_writers_at_once(tmp_path: Path, writers: dict[str, Callable[[Path], Any]], kind: str) -> None:
    """Two writers of one name leave a whole file and nothing else."""
    (tmp_path / "reference").mkdir()
    (tmp_path / "live").mkdir()
    writers[kind](tmp_path / "reference" / kind)
    failed: list[BaseException] = []

    def write() -> None:
        try:
            for _ in range(3):
                writers[kind](tmp_path / "live" / kind)
        except BaseException as error:
            failed.append(error)

    both = [threading.Thread(target=write) for _ in range(2)]
    for writer in both:
        writer.start()
    for writer in both:
        writer.join()
    assert not failed
    assert [path.name for path in (tmp_path / "live").iterdir()] == [kind]
    assert is_whole(tmp_path / "live" / kind, tmp_path / "reference" / kind)


@pytest.mark.parametrize("kind", KINDS)
def test_links_and_neighbours_are_left_alone(
    tmp_path: Path, writers: dict[str, Callable[[Path], Any]], kind: str
) -> None:
    """What a link points to, and a user's own ``.part`` file, stay as they are; the link gives way to the file."""
    treasure, own = tmp_path / "treasure", tmp_path / f"{kind}.part"
    treasure.write_text("mine")
    own.write_text("mine too")
    path = tmp_path / kind
    path.symlink_to(treasure)
    writers[kind](path)
    assert (treasure.read_text(), own.read_text()) == ("mine", "mine too")
    assert not path.is_symlink()
    assert path.stat().st_size > 4
    assert {p.name for p in tmp_path.iterdir()} == {"treasure", own.name, kind}
