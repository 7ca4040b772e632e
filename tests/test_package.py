"""The package as a whole: what importing it costs, which layer may import which, and that all versions agree."""

import ast
import importlib.metadata
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import sapopt

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(sapopt.__file__).resolve().parent

LAYERS = (
    ("cli", "sweeps"),
    ("verbs", "domains", "learning", "plotting", "report", "display"),
    ("solvers",),
    ("formulations",),
    ("certificate", "guarantees", "verification", "verification_battery", "outlook", "assignment"),
    (
        "problem",
        "dynamics",
        "benefits",
        "result",
        "control",
        "io",
        "types",
        "kernels",
        "matrices",
        "feasibility",
    ),
)
UPWARDS = {("result.py", "report")}
"""The exceptions: `Result.report` hands over to the page that shows it, inside the method."""
RANK = {name: len(LAYERS) - level for level, names in enumerate(LAYERS) for name in names}


def modules() -> list[Path]:
    """All source files of the package."""
    return sorted(PACKAGE.rglob("*.py"))


def layer(path: Path) -> str:
    """The name below ``sapopt`` that a file belongs to."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> Iterator[str]:
    """Absolute dotted names of everything a file imports at run time, inside functions as well."""
    package = ("sapopt", *path.relative_to(PACKAGE).parent.parts)

    def visit(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for child in node.orelse:
                yield from visit(child)
            return
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *([node.module] if node.module else [])))
            # `from sapopt import problem` imports a module by its name, so the names count too.
            yield from (f"{module}.{alias.name}" for alias in node.names)
        for child in ast.iter_child_nodes(node):
            yield from visit(child)

    yield from visit(ast.parse(path.read_text(encoding="utf-8")))


def layers_used(path: Path) -> set[str]:
    """The layers of sapopt that a file imports."""
    names = (name.split(".") for name in imports(path))
    return {parts[1] for parts in names if parts[0] == "sapopt" and len(parts) > 1 and parts[1] in RANK}


def run(code: str) -> str:
    """Standard output of a fresh interpreter."""
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_import_is_fast() -> None:
    """`import sapopt` takes less than a second, in processor time: other processes may have the cores."""
    code = "import time; t = time.process_time(); import sapopt; print(time.process_time() - t)"
    fastest = min(float(run(code)) for _ in range(5))
    assert fastest < 1.0


def test_import_is_light() -> None:
    """`import sapopt` and the solvers load neither torch nor matplotlib nor cvxpy."""
    heavy = "torch matplotlib cvxpy pandas dask pettingzoo"
    code = f"import sys, sapopt, sapopt.solvers; print(*[m for m in '{heavy}'.split() if m in sys.modules])"
    assert run(code).split() == []


def test_every_module_has_a_layer() -> None:
    """A new top-level module must be given its place in the layers."""
    assert {layer(path) for path in modules()} - {"__init__", "__main__"} <= set(RANK)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_downwards(path: Path) -> None:
    """No file imports a layer above its own, and torch stays under ``learning`` (and in the dual for GPUs)."""
    own = layer(path)
    if own not in ("__init__", "__main__"):
        upwards = {used for used in layers_used(path) if RANK[used] > RANK[own]}
        upwards -= {used for name, used in UPWARDS if name == path.relative_to(PACKAGE).as_posix()}
        assert not upwards, f"{own} imports upwards: {sorted(upwards)}"
    if own != "learning" and path.name != "torch_paths.py":
        assert not {name for name in imports(path) if name.split(".")[0] == "torch"}


def test_verifier_shares_no_kernels() -> None:
    """The certificate's verifier is an independent plain implementation."""
    paths = [path for path in modules() if layer(path) == "certificate"]
    for path in paths:
        assert not layers_used(path) & {"kernels", "formulations", "solvers"}
        assert not {name for name in imports(path) if name.split(".")[0] == "numba"}


def test_versions_agree() -> None:
    """pyproject.toml, the installed metadata, the module and CITATION.cff name the same version."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert importlib.metadata.version("sapopt") == declared
    assert sapopt.__version__ == declared
    assert f"\nversion: {declared}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["formulations", "solvers"])
def test_links_at_the_top(name: str) -> None:
    """The two layers are seen at the top of the tree as relative links to the real packages."""
    link = ROOT / name
    if not link.is_symlink() and not (ROOT / ".ci").exists():
        pytest.skip("an unpacked sdist has no links")
    assert link.is_symlink()
    assert link.readlink() == Path("sapopt") / name
    assert (link / "__init__.py").samefile(ROOT / "sapopt" / name / "__init__.py")
