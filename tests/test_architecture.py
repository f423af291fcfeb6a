"""Layout of the package: imports run one way, heavy libraries load only where used, one file for each law and effect.
"""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from architecture import RULES, faults, modules_of, nodes_of

from stictionid.numerics.machine_code import ahead

PACKAGE = Path(__file__).parent.parent / "stictionid"


def test_the_layout_has_no_fault() -> None:
    assert faults(PACKAGE) == []


def test_the_order_names_the_rooms_that_are_there() -> None:
    there = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert there - {"__init__", "__main__"} == set(RULES["order"])


def test_the_page_and_its_picture_are_what_the_script_writes() -> None:
    docs = PACKAGE.parent / "docs"
    drawn = runpy.run_path(str(docs / "make_architecture.py"))
    assert drawn["WAY"].keys() <= set(RULES["order"])
    for name, text in ((drawn["PAGE"], drawn["page"]()), (drawn["PICTURE"], drawn["picture"]())):
        assert (docs / name).read_text(encoding="utf-8") == text, "run docs/make_architecture.py"


# One planted fault of each kind: files of a small package, and a part of the line that must be said of it. All stand
# beside a healthy `laws/chen.py` and `fit/fit.py`.
PLANTED = {
    "import up": ({"laws/chen.py": "from ..fit.fit import fit\n"}, "house.fit.fit, which stands above it"),
    "import up in a function": ({"laws/chen.py": "def law():\n    from ..fit import fit\n"}, "which stands above it"),
    "absolute import up": ({"laws/chen.py": "import house.fit.fit\n"}, "which stands above it"),
    "room without a place": ({"herd/a.py": "from ..laws import chen\n"}, "no place in the order for 'herd'"),
    "circle of two": ({"fit/a.py": "from .b import y\n", "fit/b.py": "def f():\n    from .a import x\n"},
                      "circle: house.fit.a, house.fit.b"),
    "circle of three": ({"fit/a.py": "from .b import y\n", "fit/b.py": "from .c import z\n",
                         "fit/c.py": "from . import a\n"},
                        "circle: house.fit.a, house.fit.b, house.fit.c"),
    "circle through __init__": ({"fit/__init__.py": "from .a import x\n", "fit/a.py": "from . import name\n"},
                                "circle: house.fit, house.fit.a"),
    "circle of a folder and its subfolder": (
        {"fit/a.py": "from .noise.b import y\n", "fit/noise/b.py": "def f():\n    from ..c import z\n", "fit/c.py": ""},
        "circle of folders: house.fit, house.fit.noise"),
    "circle of three folders": (
        {"fit/x/a.py": "from ..y.b import y\n", "fit/y/b.py": "from ..z import z\n", "fit/z/__init__.py": "z = 0\n",
         "fit/z/c.py": "from ..x.d import d\n", "fit/x/d.py": ""},
        "circle of folders: house.fit.x, house.fit.y, house.fit.z"),
    "private name": ({"fit/a.py": "from ..laws.chen import _step\n"}, "imports the private _step of house.laws.chen"),
    "private name of a module": ({"fit/a.py": "from ..laws import chen\nx = chen._step\n"},
                                 "takes the private _step of chen"),
    "long module": ({"fit/a.py": "x = 1\n" * 451}, "a.py has 451 lines, more than 450"),
    "crowded folder": ({f"fit/m{i}.py": "" for i in range(16)}, "fit/ has 17 modules, more than 16"),
    "heavy library": ({"fit/a.py": "from scipy.signal import lfilter\n"}, "house.fit.a imports the heavy scipy"),
    "heavy library in a branch": ({"fit/a.py": "try:\n    import pandas\nexcept ImportError:\n    pass\n"},
                                  "imports the heavy pandas"),
    "missing module": ({"fit/a.py": "from ..laws.kano import x\n"}, "house.laws.kano, which is not there"),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_a_planted_fault_is_found(kind: str, tmp_path: Path) -> None:
    house = tmp_path / "house"
    files = {"__init__.py": "", "laws/__init__.py": "", "laws/chen.py": "", "fit/__init__.py": "",
             "fit/fit.py": "from ..laws.chen import law\n"}
    planted, said = PLANTED[kind]
    for file, text in files.items():
        (house / file).parent.mkdir(parents=True, exist_ok=True)
        (house / file).write_text(text)
    assert faults(house) == []
    for file, text in planted.items():
        (house / file).parent.mkdir(parents=True, exist_ok=True)
        (house / file).write_text(text)
    found = faults(house)
    assert any(said in line for line in found), found


def test_heavy_libraries_may_load_in_functions_for_type_checkers_and_in_their_rooms(tmp_path: Path) -> None:
    late = "def f():\n    import scipy.signal\n"
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from matplotlib.axes import Axes\n"
    for file, text in {"fit/a.py": late, "fit/b.py": typed, "batch/work/crew.py": "import multiprocessing\n"}.items():
        (tmp_path / "house" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "house" / file).write_text(text)
    assert faults(tmp_path / "house") == []


def test_catalogues_may_be_crowded(tmp_path: Path) -> None:
    for i in range(20):
        (tmp_path / "house" / "effects").mkdir(parents=True, exist_ok=True)
        (tmp_path / "house" / "effects" / f"e{i}.py").write_text("")
    assert faults(tmp_path / "house") == []


def test_every_module_imports() -> None:
    """A name that moved is found here, before anything that needs it runs."""
    for name in modules_of(PACKAGE):
        if not name.endswith("__main__"):
            importlib.import_module(name)


def test_public_names_are_no_names_of_rooms() -> None:
    import stictionid

    assert not set(stictionid.__all__) & set(RULES["order"])


def modules_loaded_by(code: str) -> set[str]:
    listed = "import atexit, sys\natexit.register(lambda: print('\\n', *sys.modules))\n"
    out = subprocess.run([sys.executable, "-c", listed + code], capture_output=True, text=True, check=True)
    return set(out.stdout.rpartition("\n ")[2].split())


def loaded_by(code: str) -> set[str]:
    return {name.partition(".")[0] for name in modules_loaded_by(code)}


def test_help_loads_nothing_heavy() -> None:
    code = "sys.argv = ['stictionid', '--help']\nfrom stictionid.cli import main\n" \
           "try:\n    main()\nexcept SystemExit:\n    pass"
    assert not loaded_by(code) & {"numpy", "scipy", "pandas", "pyarrow", "numba", "matplotlib"}


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert not loaded_by("import stictionid") & {"numpy", "scipy", "pandas", "pyarrow", "numba", "matplotlib"}


def test_identify_loads_nothing_heavy(tmp_path: Path) -> None:
    """The command with kernels on disk; numba's own import of scipy loads hardly more than its name."""
    file = PACKAGE.parent / "sample_data" / "foptd_scanned.parquet"
    code = f"sys.argv = ['stictionid', 'identify', {str(file)!r}, '-q', '-o', {str(tmp_path / 'study.json')!r}]\n" \
           "from stictionid.__main__ import main\ntry:\n    main()\nexcept SystemExit:\n    pass"
    # Kernels that are not on disk bring the compiler, and that brings scipy.linalg.
    ahead.compile_share(0, 1, lambda: True)
    found = modules_loaded_by(code)
    assert (tmp_path / "study.json").is_file() and "stictionid.verbs.identify" in found
    further = found - modules_loaded_by("import numpy, numba, pyarrow")
    assert not {name for name in further if name.partition(".")[0] in RULES["heavy"]}


def test_pandas_and_matplotlib_live_in_their_rooms() -> None:
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        room = path.relative_to(PACKAGE).parts[0]
        assert room in ("historian", "api") or "import pandas" not in text, path
        assert room in ("reports", "api") or "matplotlib" not in text, path


def test_only_the_command_line_prints_or_exits() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in ("cli", "__main__.py"):
            continue
        for node in nodes_of(path.read_text(encoding="utf-8")):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("print", "exit", "quit"), f"{path} prints or exits"


def test_a_law_an_effect_or_a_method_is_one_file_that_nobody_else_names() -> None:
    """Nothing outside its own file may import a single law, effect or method: the catalogue finds it."""
    kept = {"__init__", "contract", "physical", "option_check"}
    rooms = {room: {p.stem for p in (PACKAGE / room).glob("*.py")} - kept for room in ("laws", "effects", "methods")}
    for path in PACKAGE.rglob("*.py"):
        for node in nodes_of(path.read_text(encoding="utf-8")):
            if isinstance(node, ast.ImportFrom) and node.module:
                parts = set(node.module.split("."))
                for room, modules in rooms.items():
                    assert not (room in parts and modules & parts), f"{path} imports {node.module}"


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
    # Every test of printed text is among them, so that another processor repeats it.
    printed = {f"tests/{path.name}::{test}" for path in (PACKAGE.parent / "tests").glob("test_*.py") for test in
               re.findall(r"^@pytest\.mark\.printed\n(?:@.*\n)*def (\w+)", path.read_text(encoding="utf-8"), re.M)}
    assert len(printed) >= 5 and printed <= set(named)
