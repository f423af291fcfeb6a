"""Share of small faults, written into a copy of the package, that a room's own tests find, and those they miss.

Run: python benchmarks/mutants.py [--count 400] [--seed 0] [--room ROOM] [--minutes 60] [--again FILE]

A mutant is one edit of the syntax tree: a comparison, a number, an arithmetic operator, a condition turned round, a
neutral value returned, or a statement removed. It is written into a copy in a temporary folder, which the tests of its
room run on; the working tree is only read. A mutant is killed where a test fails or runs for three times as long as
without it. Modules that hold compiled kernels are left out: each mutant would compile for minutes.

A mutant goes through three stages until one tells it from the code: the room's quick tests, tests of whole searches,
and `short_studies.py`. The last one compares studies number by number, so no test need assert what differs there. A
survivor of the first two that changes a study is untested behaviour. One that changes no study, marked "=", is often
the same as the code: a limit that no number meets exactly, or a value that is never read. docs/mutants.md judges the
survivors of `selection`. --again takes the mutants that a printed table lists, in place of a draw.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Tests of each room: those that fail where it answers wrongly, the quickest first, as the first failure ends a run.
ROOMS = {
    "selection": ("edges_of_search", "course_of_search", "effect_names", "budget", "search_memory", "waiting",
                  "selection_numbers", "load_noise", "gates_of_strokes", "hidden_drifts", "slow_records",
                  "answer_of_search", "story", "neighbours", "policy"),
    "fit": ("unexplained", "profiles", "slow_records", "plateau", "grown", "paths"),
    "record": ("study", "tree", "oscillation", "steady_cycle", "segments"),
    "verdict": ("planned_test", "verdict"),
}
# Tests that run whole searches, asked of the survivors of the quick tests.
WHOLE = {
    "selection": ("tests/test_search.py", "tests/test_diagnose.py", "tests/test_hidden.py", *(
        f"benchmarks/long/test_{name}_long.py" for name in ("waiting", "steady_cycle", "search"))),
    "fit": ("tests/test_identify.py", "tests/test_search.py"),
    "record": ("tests/test_identify.py",),
    "verdict": ("tests/test_story.py", "tests/test_identify.py"),
}
QUICK, SEARCHES, STUDIES = STAGES = ("quick", "searches", "studies")
# What the tests read beside the package.
COPIED = ("stictionid", "tests", "benchmarks", "sample_data", "docs", "pyproject.toml", "README.md", "CONTRIBUTING.md")
# Time that a mutant may take, as a multiple of that without it, and beside that. Unit: 1 and s.
LONGER, BESIDE_S = 3.0, 20.0
# Characters of a change that a line of the table holds, and those of them before the first difference.
SHOWN, BEFORE = 74, 12
COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
            ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
REVERSED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
           ast.Pow: ast.Mult}
# Value that a function returns in place of its own, by the type that it says it returns.
NEUTRAL = {"float": "0.0", "int": "0", "bool": "False", "str": "''", "tuple": "()", "list": "[]", "dict": "{}",
           "set": "set()"}
Field = tuple[str, int | None]
# Room and path of a module.
Name = tuple[str, str]
Trees = dict[Name, ast.Module]


@dataclass(frozen=True, slots=True)
class Mutant:
    """One edit of a module: its room, its path in the package's folder, its line, and the code before and after."""

    room: str
    path: str
    line: int
    before: str
    after: str
    source: str

    @property
    def change(self) -> str:
        """The edit in one line: what differs, after a little of what does not."""
        words = [" ".join(text.split()) for text in (self.before, self.after)]
        alike = next((i for i, (a, b) in enumerate(zip(*words, strict=False)) if a != b), 0)
        first, half = max(alike - BEFORE, 0), (SHOWN - 4) // 2
        words = ["…" * (first > 0) + w[first:] for w in words]
        return " -> ".join(w if len(w) <= half else w[:half - 1] + "…" for w in words)


@dataclass(frozen=True, slots=True)
class Place:
    """A node of a syntax tree that may be changed: where it hangs, and what stands there instead."""

    parent: ast.AST
    field: Field
    node: ast.AST
    instead: ast.AST


def _children(node: ast.AST) -> Iterator[tuple[Field, ast.AST]]:
    """The children of a node that run, with the field that holds each; no annotations, decorators or docstrings."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_comment"):
            continue
        for i, child in enumerate(value if isinstance(value, list) else [value]):
            if isinstance(child, ast.AST):
                yield (name, i if isinstance(value, list) else None), child


def _neutral(function: ast.AST) -> str:
    """The neutral value of a function's return type, as code."""
    said = ast.unparse(function.returns) if isinstance(function, ast.FunctionDef) and function.returns else ""
    return NEUTRAL.get(said.partition("[")[0], "None")


def _edits(node: ast.AST, function: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a syntax tree by which a mutant may replace a node."""
    if isinstance(node, ast.Compare):
        for table in (COMPARED, REVERSED):
            if other := table.get(type(node.ops[0])):
                yield ast.Compare(node.left, [other(), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield ast.Constant(node.value + 1 if isinstance(node.value, int) else 2.0 * node.value or 1.0)
        if node.value:
            yield ast.Constant(-node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.BinOp) and type(node.op) in COUNTED:
        yield ast.BinOp(node.left, COUNTED[type(node.op)](), node.right)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.If):
        yield ast.If(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)
    elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != _neutral(function):
        yield ast.Return(ast.parse(_neutral(function), mode="eval").body)
    elif isinstance(node, (ast.AugAssign, ast.Raise)) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)) or (
            isinstance(node, ast.Assign) and isinstance(node.targets[0], (ast.Attribute, ast.Subscript))):
        yield ast.Pass()


def places(tree: ast.Module) -> list[Place]:
    """All edits of a module, in the order of its lines."""
    found: list[Place] = []

    def walk(node: ast.AST, function: ast.AST) -> None:
        for field, child in _children(node):
            if isinstance(child, ast.If) and getattr(child.test, "id", "") == "TYPE_CHECKING":
                continue
            found.extend(Place(node, field, child, instead) for instead in _edits(child, function))
            walk(child, child if isinstance(child, ast.FunctionDef) else function)

    walk(tree, tree)
    return found


def _written(tree: ast.Module, place: Place) -> str:
    """The module's code with one edit; the tree is put back."""
    name, i = place.field
    held = getattr(place.parent, name)
    if i is None:
        setattr(place.parent, name, place.instead)
    else:
        held[i] = place.instead
    source = ast.unparse(ast.fix_missing_locations(tree))
    if i is None:
        setattr(place.parent, name, held)
    else:
        held[i] = place.node
    return source


def compiled(source: str) -> bool:
    """True for a module that holds a kernel."""
    return any("kernel" in map(ast.unparse, node.decorator_list) for node in ast.walk(ast.parse(source))
               if isinstance(node, ast.FunctionDef))


def drawn(count: int, seed: int, rooms: tuple[str, ...] = tuple(ROOMS), root: Path = ROOT) -> list[Mutant]:
    """So many mutants of some rooms, in a random order; all edits of all modules are equally likely."""
    trees, found = _edited(rooms, root)
    chosen = random.Random(seed).sample(found, min(count, len(found)))
    return [_mutant(trees, *each) for each in chosen]


def every_mutant(rooms: tuple[str, ...] = tuple(ROOMS), root: Path = ROOT) -> Iterator[Mutant]:
    """All mutants of some rooms, in the order of their lines."""
    trees, found = _edited(rooms, root)
    return (_mutant(trees, *each) for each in found)


def _edited(rooms: tuple[str, ...], root: Path) -> tuple[Trees, list[tuple[Name, Place]]]:
    """The syntax trees of some rooms by room and path, and all places of edits with the name of their tree."""
    trees: Trees = {}
    found: list[tuple[Name, Place]] = []
    for room in rooms:
        for path in sorted((root / "stictionid" / room).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if not compiled(source):
                name = room, path.relative_to(root).as_posix()
                trees[name] = ast.parse(source)
                found += [(name, place) for place in places(trees[name])]
    return trees, found


def _mutant(trees: Trees, name: Name, place: Place) -> Mutant:
    return Mutant(*name, getattr(place.node, "lineno", 0), _said(place.node), _said(place.instead),
                  _written(trees[name], place))


def _said(node: ast.AST) -> str:
    """The code of a node; of a condition only its test."""
    return f"if {ast.unparse(node.test)}" if isinstance(node, ast.If) else ast.unparse(node)


class Copy:
    """A copy of the repository in a temporary folder, in which one module at a time is another."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in COPIED:
            if (ROOT / name).is_dir():
                # (Times of files are kept, so that the kernels compiled so far fit them.)
                shutil.copytree(ROOT / name, folder / name, symlinks=True)
            elif (ROOT / name).exists():
                shutil.copy2(ROOT / name, folder / name)

    def passes(self, room: str, stage: str = QUICK, limit_s: float | None = None) -> bool:
        """True where a stage of a room ends well in time; the first run of the studies writes them."""
        tests = [f"tests/test_{name}.py" for name in ROOMS[room]] if stage == QUICK else WHOLE[room]
        words = ["benchmarks/short_studies.py", "studies.json"] if stage == STUDIES else \
            ["-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
        env = {**os.environ, "PYTHONPATH": str(self.folder), "OPENBLAS_NUM_THREADS": "1"}
        process = subprocess.Popen([sys.executable, *words], cwd=self.folder, env=env, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.DEVNULL, start_new_session=True)
        try:
            return process.wait(limit_s) == 0
        except subprocess.TimeoutExpired:
            return False
        finally:
            if process.poll() is None:
                # The tests may have started processes of their own.
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def told_by(self, mutant: Mutant, limits: Mapping[str, float]) -> str:
        """The first stage that tells a mutant from the code, empty where none does; the module is put back."""
        path = self.folder / mutant.path
        before, times = path.read_bytes(), path.stat()
        try:
            self._write(path, mutant.source.encode())
            return next((stage for stage, s in limits.items() if not self.passes(mutant.room, stage, s)), "")
        finally:
            self._write(path, before)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    @staticmethod
    def _write(path: Path, content: bytes) -> None:
        path.write_bytes(content)
        for old in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            # Bytecode is told by second and size, which two mutants may share.
            old.unlink()


def listed(printed: str, mutants: Iterable[Mutant]) -> list[Mutant]:
    """The mutants whose place and change a printed table lists, each as often as it does."""
    lines = printed.partition("survivors:\n")[2].splitlines()
    wanted = Counter((place, change.lstrip("= ")) for place, change in zip(lines[::2], lines[1::2], strict=True))
    found = []
    for mutant in mutants:
        name = f"{mutant.path}:{mutant.line}", mutant.change
        if wanted[name] > 0:
            wanted[name] -= 1
            found.append(mutant)
    return found


def table(told: Sequence[tuple[Mutant, str]], stages: Sequence[str] = STAGES) -> Iterator[str]:
    """The lines of the table, a row a room, and of the survivors; `told` gives each mutant the stage that told it."""
    tests = [stage for stage in stages if stage != STUDIES]
    yield f"{'room':12}{'mutants':>8}" + "".join(f"{stage:>16}" for stage in stages) + f"{'left':>8}"
    for room in (*dict.fromkeys(m.room for m, _ in told), "all"):
        of_room = [stage for m, stage in told if room in (m.room, "all")]
        row = f"{room:12}{len(of_room):8}"
        for stage in stages:
            count = of_room.count(stage)
            row += f"{count:8}{count / max(len(of_room), 1):8.0%}"
        yield row + f"{of_room.count(''):8}"
    survivors = sorted(((m, s) for m, s in told if s not in tests), key=lambda each: (each[0].path, each[0].line))
    if survivors:
        yield "survivors:"
    for m, stage in survivors:
        yield f"{m.path}:{m.line}"
        yield f"{'    ' if stage or STUDIES not in stages else '  = '}{m.change}"


def main() -> int:
    """Print the table; 1 where a stage fails without a mutant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=400, help="mutants drawn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--room", choices=ROOMS, action="append", help="may be given again; all rooms when left out")
    parser.add_argument("--stage", choices=STAGES, action="append", help="may be given again; all when left out")
    parser.add_argument("--again", type=Path, metavar="FILE", help="a printed table: its survivors, in place of a draw")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="time after which no mutant is begun")
    args = parser.parse_args()
    end = time.monotonic() + 60.0 * args.minutes
    rooms, stages = tuple(args.room or ROOMS), [s for s in STAGES if s in (args.stage or STAGES)]
    if args.again:
        mutants = listed(args.again.read_text(encoding="utf-8"), every_mutant(rooms))
        print(f"{len(mutants)} mutants of {args.again.name}", flush=True)
    else:
        mutants = drawn(args.count, args.seed, rooms)
        print(f"{len(mutants)} mutants, seed {args.seed}", flush=True)
    told: list[tuple[Mutant, str]] = []
    limits: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for mutant in mutants:
            room = mutant.room
            if time.monotonic() > end:
                break
            if room not in limits:
                limits[room] = {}
                for stage in stages:
                    begin = time.monotonic()
                    if not copy.passes(room, stage):
                        print(f"the stage {stage} of {room} fails without a mutant")
                        return 1
                    limits[room][stage] = LONGER * (time.monotonic() - begin) + BESIDE_S
            told.append((mutant, copy.told_by(mutant, limits[room])))
            print(f"{len(told)} {mutant.path}:{mutant.line} {told[-1][1]}", file=sys.stderr, flush=True)
    print(*table(told, stages), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
