"""The package as a whole: what importing it costs, which layer may import which, and that all versions agree."""

import ast
import importlib.metadata
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sapopt
from sapopt import SAP, SwitchingCost, certify, solve
from sapopt.dynamics import Battery, SlewCost, SyntheticSwitching
from sapopt.dynamics.registry import BUILT_IN
from sapopt.solvers import HAA

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(sapopt.__file__).resolve().parent

LAYERS = (
    ("cli",),
    ("sweeps",),
    ("warming",),
    ("api", "live"),
    ("domains", "exchange", "learning", "report"),
    ("solvers", "plotting"),
    ("formulations",),
    ("running", "proofs"),
    ("problem",),
    ("dynamics",),
    ("data",),
    ("kernels",),
)
"""From the top down. Folders of one layer do not import each other."""
UPWARDS = {
    ("problem/result.py", "report"),
    ("problem/result.py", "exchange"),
    ("problem/sap.py", "exchange"),
}
"""The exceptions: inside their methods, `Result.report` hands over to the page that shows it, and problems and results
to what reads and writes tables and the files of other programs."""
BUILT_ON = {
    "joint": {"switching"},
}
"""Families of dynamics that stand on another one."""
LOCAL_RULES = {
    "switching": SwitchingCost(0.3),
    "idle": SwitchingCost(0.3, idle_is_free=True),
    "battery": Battery(0.3),
    "copies": SyntheticSwitching(0.3),
    "slew": SlewCost(0.3, np.full((4, 2, 3), 2.0) + np.arange(24).reshape(4, 2, 3) / 10, np.eye(3)),
}
RANK = {name: len(LAYERS) - level for level, names in enumerate(LAYERS) for name in names}


def modules() -> list[Path]:
    """All source files of the package."""
    return sorted(PACKAGE.rglob("*.py"))


def layer(path: Path) -> str:
    """The name below ``sapopt`` that a file belongs to."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> Iterator[str]:
    """Absolute dotted names of everything a file imports: inside functions and for type checkers as well."""
    package = ("sapopt", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *([node.module] if node.module else [])))
            # `from sapopt import problem` imports a module by its name, so the names count too.
            yield from (f"{module}.{alias.name}" for alias in node.names)


def layers_used(path: Path) -> set[str]:
    """The folders of sapopt that a file imports, its own left out."""
    names = (name.split(".") for name in imports(path))
    used = {parts[1] for parts in names if parts[0] == "sapopt" and len(parts) > 1 and parts[1] in RANK}
    return used - {layer(path)}


def run(code: str) -> str:
    """Standard output of a fresh interpreter."""
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_import_is_fast() -> None:
    """`import sapopt` takes less than a second, in processor time: other processes may have the cores."""
    code = "import time; t = time.process_time(); import sapopt; print(time.process_time() - t)"
    fastest = min(float(run(code)) for _ in range(5))
    assert fastest < 1.0


def test_import_is_light() -> None:
    """`import sapopt` and the solvers load no heavy package: those are imported when first needed."""
    heavy = "clarabel cvxpy czml3 dask highspy matplotlib networkx numba pettingzoo rich sgp4 torch typer"
    heavy += " openpyxl pandas pyarrow scipy.linalg scipy.optimize scipy.stats"
    code = f"import sys, sapopt, sapopt.solvers; print(*[m for m in '{heavy}'.split() if m in sys.modules])"
    assert run(code).split() == []


def test_every_module_has_a_layer() -> None:
    """A new top-level module must be given its place in the layers."""
    assert {layer(path) for path in modules()} - {"__init__", "__main__"} <= set(RANK)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_downwards(path: Path) -> None:
    """A file imports lower folders only, and torch stays under ``learning`` (and in the paths for GPUs)."""
    own = layer(path)
    if own not in ("__init__", "__main__"):
        upwards = {used for used in layers_used(path) if RANK[used] >= RANK[own]}
        upwards -= {used for name, used in UPWARDS if name == path.relative_to(PACKAGE).as_posix()}
        assert not upwards, f"{own} imports upwards: {sorted(upwards)}"
    if own != "learning" and path.name != "torch_paths.py":
        assert not {name for name in imports(path) if name.split(".")[0] == "torch"}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_families_of_dynamics_keep_apart(path: Path) -> None:
    """Under ``dynamics`` the families stand beside each other: none imports another, but for what it is built on."""
    parts = path.relative_to(PACKAGE).parts
    if parts[0] != "dynamics" or len(parts) < 3:
        return
    used = {name.split(".")[2] for name in imports(path) if name.startswith("sapopt.dynamics.")}
    families = {folder.name for folder in (PACKAGE / "dynamics").iterdir() if folder.is_dir()}
    assert used & families <= {parts[1]} | BUILT_ON.get(parts[1], {"paths"})


PROBING = {"dynamics/capabilities.py", "kernels/compiling.py"}
"""Files that may ask an object by name: a user's dynamics, and the modules that a kernel calls into."""
DYNAMICS = {*BUILT_IN, "AgentLocal"}


def probes(path: Path) -> Iterator[str]:
    """Questions to an object of unknown kind by the name of an attribute, and to a dynamics by its class."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        asked = ast.unparse(node)
        of_class = {
            name.id for part in node.args[1:] for name in ast.walk(part) if isinstance(name, ast.Name)
        }
        names_it = "__name__" in asked  # what to call a function in a message
        if asked.startswith("hasattr(os, "):  # what the platform has
            continue
        if node.func.id == "hasattr" or (node.func.id == "getattr" and len(node.args) > 2 and not names_it):
            yield f"line {node.lineno}: {asked}"
        if node.func.id in ("isinstance", "issubclass") and of_class & DYNAMICS:
            yield f"line {node.lineno}: {asked}"
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Compare)
            and {n.id for n in ast.walk(node) if isinstance(n, ast.Name)} & DYNAMICS
        ):
            yield f"line {node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_object_is_asked_by_name(path: Path) -> None:
    """What an object can do is typed; one module looks at a user's object by name, and no other one does."""
    if path.relative_to(PACKAGE).as_posix() not in PROBING:
        assert list(probes(path)) == []


MOST_ARGUMENTS = 12
"""What belongs together is a dataclass, or in a kernel a named tuple, rather than more arguments than that."""


def long_lists(path: Path) -> Iterator[str]:
    """Functions of a file that take more arguments than they may, `self` among them."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            taken = node.args
            count = len(taken.posonlyargs) + len(taken.args) + len(taken.kwonlyargs)
            if count > MOST_ARGUMENTS:
                yield f"line {node.lineno}: {count} arguments"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_function_takes_too_many_arguments(path: Path) -> None:
    """No function takes more than twelve arguments, kernels and commands included."""
    assert list(long_lists(path)) == []


def test_the_verifier_names_no_kernels() -> None:
    """What checks certificates imports no kernel, formulation or solver, not even inside a function."""
    paths = [path for path in modules() if layer(path) == "proofs"]
    assert len(paths) > 3
    for path in paths:
        assert not layers_used(path) & {"kernels", "formulations", "solvers"}
        assert not {name for name in imports(path) if name.split(".")[0] == "numba"}


def test_the_verifier_runs_without_a_compiler(tmp_path: Path) -> None:
    """Nothing that a verification reaches is compiled: every built-in rule is checked without numba."""
    rng = np.random.default_rng(3)
    for name, dynamics in LOCAL_RULES.items():
        problem = SAP(rng.random((4, 2, 3)), dynamics, [0, 1])
        problem.save(tmp_path / f"{name}.npz")
        certify(problem, solve(problem, HAA())).save(tmp_path / f"{name}-certificate.npz")
    said = run(
        "import sys; sys.modules['numba'] = None\n"
        "from sapopt import SAP, verify\n"
        f"for name in {list(LOCAL_RULES)}:\n"
        f"    verify(f'{tmp_path}/{{name}}-certificate.npz', SAP.load(f'{tmp_path}/{{name}}.npz'))\n"
        "    print(name)"
    )
    assert said.split() == list(LOCAL_RULES)


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
