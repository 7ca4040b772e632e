"""The decorator of the kernels: what it compiles, when, and what it does about caches that cannot be used."""

from __future__ import annotations

import ast
import gc
import importlib
import importlib.util
import inspect
import logging
import os
import pickle
import pkgutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import sapopt
from sapopt.kernels import clock, jit, matching

SOURCE = """
from sapopt.kernels.jit import njit

@njit(cache=True, no_cpython_wrapper=True)
def double(x):
    return 2.0 * x

@njit(cache=True, nogil=True, small=10)
def total(values):
    out = 0.0
    for v in values:
        out += double(v)
    return out
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A file with two kernels, one of which calls the other."""
    path = tmp_path / "kernels_of_a_test.py"
    path.write_text(SOURCE)
    return path


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The kernels of the file as a new process would have them."""
    monkeypatch.setattr(jit, "KERNELS", [])
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_small_work_is_not_compiled(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few numbers run the plain source, many are compiled, and what is compiled serves small work too."""
    monkeypatch.setattr(jit, "_spent", 0.0)
    kernels = load(source, monkeypatch)
    assert kernels.total(np.ones(10)) == 20.0
    assert kernels.total._dispatcher is None
    assert kernels.total(np.ones(11)) == 22.0
    assert len(kernels.total.dispatcher.signatures) == 1
    assert kernels.total(np.ones(3)) == 6.0


def test_patience_ends(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has spent its time in interpreted kernels compiles the next one."""
    monkeypatch.setattr(jit, "_spent", 2 * jit.PATIENCE)
    kernels = load(source, monkeypatch)
    assert kernels.total(np.ones(2)) == 4.0
    assert len(kernels.total.dispatcher.signatures) == 1


def test_helpers_can_be_called_from_python(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A helper has no compiled way in from Python, so its source runs, also after it was compiled for another."""
    kernels = load(source, monkeypatch)
    with jit.compiled_always():
        assert kernels.double(1.5) == 3.0
        assert kernels.total(np.ones(2)) == 4.0
    assert kernels.double(1.5) == 3.0


def test_kernels_are_pickled_by_name() -> None:
    """Other processes get a kernel by its name, as they would a function."""
    assert pickle.loads(pickle.dumps(matching.match)) is matching.match


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["cut", "emptied", "changed"])
def test_damaged_cache_files(
    source: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, suffix: str, damage: str
) -> None:
    """A damaged cache file is thrown away, compiled anew, and good at the next run."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(source.parent / "cache"))
    assert load(source, monkeypatch).total(np.ones(20)) == 40.0
    files = [path for path in source.parent.rglob(f"*{suffix}") if "total" in path.name]
    assert len(files) == 1
    content = files[0].read_bytes()
    middle = len(content) // 2
    files[0].write_bytes(
        {
            "cut": content[:middle],
            "emptied": b"",
            "changed": content[:middle] + bytes([content[middle] ^ 255]) + content[middle + 1 :],
        }[damage]
    )
    again = load(source, monkeypatch)
    with caplog.at_level(logging.WARNING, logger="sapopt"):
        assert again.total(np.ones(20)) == 40.0
    whole = load(source, monkeypatch)
    assert whole.total(np.ones(20)) == 40.0
    assert sum(whole.total.dispatcher.stats.cache_hits.values()) == 1


def test_a_changed_callee_makes_the_cache_stale(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code holds its callees, so a kernel is compiled anew when the file of a callee has changed."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(source.parent / "cache"))
    other = source.with_name("callee_of_a_test.py")
    other.write_text("from sapopt.kernels.jit import njit\n\n@njit\ndef scaled(x):\n    return 2.0 * x\n")
    source.write_text(
        "from callee_of_a_test import scaled\n"
        "from sapopt.kernels.jit import njit\n\n@njit\ndef total(values):\n    return scaled(values[0])\n"
    )
    monkeypatch.syspath_prepend(str(source.parent))
    for factor in (2.0, 3.0):
        other.write_text(other.read_text().replace("2.0", f"{factor:.1f}"))
        monkeypatch.delitem(sys.modules, "callee_of_a_test", raising=False)
        importlib.invalidate_caches()
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        assert load(source, monkeypatch).total(np.ones(20)) == factor


def test_no_folder_for_a_cache(source: Path) -> None:
    """Where neither the package's folder nor the home can be written, kernels are compiled without a cache."""
    (source.parent / "__pycache__").write_text("a file, so that nobody can make the folder, root included")
    home = source.parent / "kernels_of_a_test.py" / "home"
    code = "import numpy as np, kernels_of_a_test as k; print(k.total(np.ones(20)))"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    path = os.pathsep.join([str(source.parent), *(p for p in sys.path if p)])
    ran = subprocess.run(
        [sys.executable, "-B", "-c", code], capture_output=True, text=True, check=True,
        env=environment | {"HOME": str(home), "XDG_CACHE_HOME": str(home), "PYTHONPATH": path},
    )  # fmt: skip
    assert ran.stdout.strip() == "40.0"


def test_the_compiler_is_timed_and_told_of(
    source: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Seconds of compiling are counted, and a compilation that takes long is logged once."""
    heard: list[str] = []
    monkeypatch.setattr(clock, "_LONG", 0.0)
    monkeypatch.setattr(clock, "_told", False)
    monkeypatch.setattr("numba.config.CACHE_DIR", str(source.parent / "cache"))
    before = clock.compile_seconds()
    stands = clock.now()
    began = time.perf_counter()
    with caplog.at_level(logging.INFO, logger="sapopt"), clock.told_when_long(heard.append):
        load(source, monkeypatch).total(np.ones(20))
    assert clock.compile_seconds() > before
    assert clock.now() - stands == pytest.approx(
        time.perf_counter() - began - (clock.compile_seconds() - before), abs=1e-2
    )
    assert len(heard) == 1
    assert [record.message for record in caplog.records if record.name == clock.__name__] == heard


@pytest.mark.parametrize("collects", [True, False])
def test_the_compiler_is_not_held_up_by_the_collector(
    source: Path, monkeypatch: pytest.MonkeyPatch, collects: bool
) -> None:
    """No garbage is collected while a kernel is compiled; afterwards it is as before."""
    seen: list[bool] = []
    ends = clock.compiler_ends

    def told() -> None:
        seen.append(gc.isenabled())
        ends()

    monkeypatch.setattr(clock, "compiler_ends", told)
    monkeypatch.setattr("numba.config.CACHE_DIR", str(source.parent / "cache"))
    before = gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        load(source, monkeypatch).total(np.ones(20))
        assert gc.isenabled() == collects
    finally:
        (gc.enable if before else gc.disable)()
    assert seen
    assert not any(seen)


def _is_slice(target: ast.expr) -> bool:
    return isinstance(target, ast.Subscript) and any(
        isinstance(part, ast.Slice) for part in ast.walk(target.slice)
    )


def _makes_arrays(kernel: jit.Kernel) -> list[str]:
    """Expressions of a kernel's source that make an array, a list or a copy."""
    plain = {
        "int64",
        "int32",
        "float64",
        "exp",
        "log",
        "sqrt",
        "abs",
        "isnan",
        "isinf",
        "isfinite",
        "nextafter",
    }
    found = []
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kernel.py_func)))):
        if isinstance(node, (ast.List, ast.ListComp, ast.Dict, ast.Set)):
            found.append(ast.unparse(node))
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if (name.startswith("np.") and name[3:] not in plain) or name.endswith(".copy"):
                found.append(name)
        elif isinstance(node, ast.Assign) and not isinstance(node.value, ast.Constant):
            # numba copies what is assigned to a slice, in case the two overlap
            found += [ast.unparse(node) for target in node.targets if _is_slice(target)]
    return found


def _import_everything() -> None:
    for module in pkgutil.walk_packages(sapopt.__path__, "sapopt."):
        if "torch" not in module.name and "learning" not in module.name:
            importlib.import_module(module.name)


def test_kernels_that_borrow_make_and_return_no_array() -> None:
    """A kernel without counting of references would leak an array that it made, and free one that it returned."""
    from numba import types

    _import_everything()
    borrowing = [kernel for kernel in jit.KERNELS if kernel.options.get("_nrt") is False]
    assert len(borrowing) > 50
    assert {repr(kernel): _makes_arrays(kernel) for kernel in borrowing if _makes_arrays(kernel)} == {}
    for kernel in borrowing:
        for compiled in kernel.dispatcher.overloads.values() if kernel._dispatcher is not None else ():
            returned = compiled.signature.return_type
            parts = returned.types if isinstance(returned, types.BaseTuple) else (returned,)
            assert not any(isinstance(part, types.Array) for part in parts), (kernel, returned)


def _literals(kernel: jit.Kernel) -> list[str]:
    """Arguments of calls to other kernels that the compiler sees as numbers of a type of their own."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kernel.py_func)))
    plain = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                pairs = zip(names, values, strict=False)
                plain |= {ast.unparse(n) for n, v in pairs if isinstance(n, ast.Name) and _is_whole(v)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _called(kernel, node) is not None:
            found += [
                f"{ast.unparse(node.func)}({ast.unparse(argument)})"
                for argument in node.args
                if _is_whole(argument) or ast.unparse(argument) in plain
            ]
    return found


def _is_whole(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp):
        node = node.operand
    return isinstance(node, ast.Constant) and type(node.value) is int


def _called(kernel: jit.Kernel, node: ast.Call) -> jit.Kernel | None:
    names = kernel.py_func.__globals__
    target = node.func
    if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name):
        value = getattr(names.get(target.value.id), target.attr, None)
    else:
        value = names.get(target.id) if isinstance(target, ast.Name) else None
    return value if isinstance(value, jit.Kernel) else None


def test_no_kernel_is_compiled_for_a_single_number() -> None:
    """numba compiles a helper once more for a literal 0, or a variable that begins as one: np.int64(0) instead."""
    _import_everything()
    assert {repr(kernel): found for kernel in jit.KERNELS if (found := _literals(kernel))} == {}
