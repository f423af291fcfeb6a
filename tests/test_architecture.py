"""The house: imports run one way, heavy rooms load only where they are used, one file for each law and effect."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "stictionid"
# Rooms from the ground up: a module may import from rooms further down only (or from its own).
FLOORS = [
    {"_version", "errors", "kernels", "signals"},
    {"rooms"},
    {"loop", "files", "spreadsheet"},
    {"parameters", "results", "products"},
    {"process", "regression", "search", "noise", "armax", "conic", "spec"},
    {"blockwise", "lagbank"},
    {"laws", "descent", "folds"},
    {"effects", "between"},
    {"scan"},
    {"model", "oscillation", "export", "bench", "hidden", "resonance"},
    {"restarts", "segments"},
    {"rerun"},
    {"arx", "moves", "simulate", "historian", "gates", "steptest", "rounding"},
    {"ridge"},
    {"starts", "profiles", "grown", "absorbed", "explained"},
    {"plateaus", "smooth", "windows", "herd"},
    {"intervals"},
    {"fit", "position"},
    {"refit", "whitened", "unheld"},
    {"heldout", "addition", "effect_numbers"},
    {"methods", "lawrank"},
    {"severity", "excerpt"},
    {"causes"},
    {"verdict"},
    {"identify"},
    {"compare", "screen", "agreement"},
    {"diagnose"},
    {"report", "selftest"},
    {"batch"},
    {"cli"},
]
FLOOR_OF = {room: i for i, rooms in enumerate(FLOORS) for room in rooms}


def imports_of(path: Path) -> set[str]:
    """Top rooms of the package that a file imports, wherever in the file."""
    found = set()
    package = ("stictionid", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            for name in names:
                full = (*base, *name.split("."))
                if len(full) > 1:
                    found.add(full[1])
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_downwards(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if room in ("__init__", "__main__"):
        return
    assert room in FLOOR_OF, f"{room} has no floor: add it to FLOORS"
    for other in imports_of(path) - {room}:
        assert FLOOR_OF[other] < FLOOR_OF[room], f"{room} imports {other}, which is not below it"


def test_every_module_imports() -> None:
    """A name that moved is found here, before anything that needs it runs."""
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if parts[-1] != "__main__":
            importlib.import_module(".".join(p for p in parts if p != "__init__"))


def loaded_by(code: str) -> set[str]:
    out = subprocess.run([sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules)"], capture_output=True,
                         text=True, check=True)
    return {name.partition(".")[0] for name in out.stdout.split()}


def test_help_loads_nothing_heavy() -> None:
    code = "sys.argv = ['stictionid', '--help']\nfrom stictionid.cli import main\n" \
           "try:\n    main()\nexcept SystemExit:\n    pass"
    assert not loaded_by(code) & {"numpy", "scipy", "pandas", "pyarrow", "numba", "matplotlib"}


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert not loaded_by("import stictionid") & {"numpy", "scipy", "pandas", "pyarrow", "numba", "matplotlib"}


def test_pandas_and_matplotlib_live_in_one_room_each() -> None:
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        room = path.relative_to(PACKAGE).parts[0]
        assert room == "historian" or "import pandas" not in text, path
        assert room == "report" or "matplotlib" not in text, path


def test_only_the_command_line_prints_or_exits() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in ("cli", "__main__.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("print", "exit", "quit"), f"{path} prints or exits"


@pytest.mark.parametrize("room", ["laws", "effects", "methods"])
def test_a_law_or_an_effect_is_one_file_that_nobody_else_names(room: str) -> None:
    """Nothing outside its own file may import a single law or effect: the catalogue finds it."""
    modules = {p.stem for p in (PACKAGE / room).glob("*.py")} - {"__init__", "contract", "physical", "options", "run",
                                                              "structure"}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                parts = node.module.split(".")
                assert not (room in parts and modules & set(parts)), f"{path} imports {node.module}"


def test_the_oldest_dependencies_that_are_tested_are_the_oldest_that_are_allowed() -> None:
    import tomllib

    allowed = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    pinned = [line for line in (PACKAGE.parent / ".ci" / "oldest.txt").read_text(encoding="utf-8").splitlines()
              if line and not line.startswith("#")]
    assert pinned == [f"{line.replace('>=', '==')}.*" for line in allowed]


def test_what_runs_elsewhere_is_there() -> None:
    lines = (PACKAGE.parent / ".ci" / "elsewhere.txt").read_text(encoding="utf-8").splitlines()
    named = [line.removeprefix("--deselect=") for line in lines if line and not line.startswith("#")]
    assert len(named) > 10
    for file, _, test in (name.partition("::") for name in named):
        text = (PACKAGE.parent / file).read_text(encoding="utf-8")
        assert f"\ndef {test}(" in text if test else "\ndef test_" in text, file
