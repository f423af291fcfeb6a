"""Imports of a package, and the faults of its layout against the rules in architecture.toml."""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

RULES = tomllib.loads((Path(__file__).parent / "architecture.toml").read_text(encoding="utf-8"))
RULES["order"] = [room for floor in RULES["floors"] for room in floor["rooms"]]


@dataclass(frozen=True)
class Import:
    """A module that takes a name from another; `name` is None where it takes the module itself."""

    by: str
    of: str
    name: str | None


@cache
def tree_of(text: str) -> ast.Module:
    """The syntax tree of a module; a text is parsed once in a process."""
    return ast.parse(text)


@cache
def nodes_of(text: str) -> tuple[ast.AST, ...]:
    """Imports, attributes and calls, wherever in a module; a text is walked once in a process."""
    return tuple(node for node in ast.walk(tree_of(text))
                 if isinstance(node, ast.Import | ast.ImportFrom | ast.Attribute | ast.Call))


def modules_of(package: Path) -> dict[str, Path]:
    """Dotted name, the package's own first, of every module; an `__init__` bears the name of its folder."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = (package.name, *path.relative_to(package).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(name: str, path: Path, modules: dict[str, Path]) -> Iterator[Import]:
    """Imports of the package's own modules, wherever in the file."""
    folder = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    own = name.split(".")[0]
    for node in nodes_of(path.read_text(encoding="utf-8")):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == own:
                    yield Import(name, alias.name, None)
        elif isinstance(node, ast.ImportFrom):
            above = folder[: len(folder) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            if base.split(".")[0] != own:
                continue
            for alias in node.names:
                inside = f"{base}.{alias.name}"
                yield Import(name, inside, None) if inside in modules else Import(name, base, alias.name)


def faults(package: Path, rules: dict[str, object] = RULES) -> list[str]:
    """One line a fault: imports up, circles, private names, long modules, crowded folders, heavy imports."""
    modules = modules_of(package)
    taken = [each for name, path in modules.items() for each in imports_of(name, path, modules)]
    return [*_unknown(taken, modules), *_upward(taken, list(rules["order"])), *_circles(taken),  # type: ignore[call-overload]
            *_folder_circles(taken, modules), *_private(taken, modules), *_large(package, modules, rules),
            *_heavy(modules, rules)]


def room_of(name: str) -> str:
    """Folder or top-level module in which a module stands; "" for the package itself."""
    return (*name.split("."), "")[1]


def _unknown(taken: list[Import], modules: dict[str, Path]) -> list[str]:
    return [f"{each.by} imports {each.of}, which is not there" for each in taken if each.of not in modules]


def _upward(taken: list[Import], order: list[str]) -> list[str]:
    found = []
    for each in taken:
        by, of = room_of(each.by), room_of(each.of)
        if by in ("", "__main__") or by == of:
            continue
        if by not in order or of not in order:
            found.append(f"{each.by} imports {each.of}: no place in the order for {(by if by not in order else of)!r}")
        elif order.index(of) > order.index(by):
            found.append(f"{each.by} imports {each.of}, which stands above it")
    return found


def _circles(taken: list[Import]) -> list[str]:
    return ["circle: " + ", ".join(members) for members in _rings((each.by, each.of) for each in taken)]


def _folder_circles(taken: list[Import], modules: dict[str, Path]) -> list[str]:
    """Folders that import each other, directly or around; a subfolder is one of its own, the package's own is none."""
    def folder_of(name: str) -> str:
        return name if modules[name].name == "__init__.py" else name.rpartition(".")[0]

    between = {(folder_of(each.by), folder_of(each.of)) for each in taken if each.of in modules}
    counted = [(by, of) for by, of in sorted(between) if "." in by and "." in of]
    return ["circle of folders: " + ", ".join(members) for members in _rings(counted)]


def _rings(edges: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Sets of names that lead to each other, directly or around (Tarjan's strongly connected components)."""
    after: dict[str, set[str]] = {}
    for by, of in edges:
        after.setdefault(by, set()).add(of)
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    open_: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        number[module] = low[module] = len(number)
        open_.append(module)
        for other in sorted(after.get(module, ())):
            if other == module:
                continue
            if other not in number:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in open_:
                low[module] = min(low[module], number[other])
        if low[module] == number[module]:
            members = open_[open_.index(module):]
            del open_[open_.index(module):]
            if len(members) > 1:
                found.append(sorted(members))

    for module in sorted(after):
        if module not in number:
            visit(module)
    return found


def _private(taken: list[Import], modules: dict[str, Path]) -> list[str]:
    """Names that begin with one underscore and are imported, or taken from an imported module, in another file."""
    found = [f"{each.by} imports the private {each.name} of {each.of}" for each in taken
             if each.name and each.name.startswith("_") and not each.name.startswith("__")]
    for name, path in modules.items():
        aliases = {}
        nodes = nodes_of(path.read_text(encoding="utf-8"))
        own = {each.of.rpartition(".")[2] for each in taken if each.by == name and each.name is None}
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.level:
                aliases.update({a.asname or a.name: a.name for a in node.names if a.name in own})
        for node in nodes:
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases \
                    and node.attr.startswith("_") and not node.attr.startswith("__"):
                found.append(f"{name} takes the private {node.attr} of {aliases[node.value.id]}")
    return found


def _large(package: Path, modules: dict[str, Path], rules: dict[str, object]) -> list[str]:
    longest, most = int(rules["longest_module"]), int(rules["most_modules"])  # type: ignore[call-overload]
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in modules.values()}
    found = [f"{path.relative_to(package)} has {n} lines, more than {longest}" for path, n in lines.items()
             if n > longest]
    crowd = Counter(path.parent for path in modules.values() if path.name != "__init__.py")
    return found + [f"{folder.name}/ has {n} modules, more than {most}" for folder, n in crowd.items()
                    if n > most and folder.name not in rules["catalogues"]]  # type: ignore[operator]


def _heavy(modules: dict[str, Path], rules: dict[str, object]) -> list[str]:
    """Modules that load a heavy library as they are imported, and are no exception."""
    allowed: dict[str, list[str]] = rules["heavy"]  # type: ignore[assignment]
    found = []
    for name, path in modules.items():
        inside = name.partition(".")[2]
        for library in _loaded(tree_of(path.read_text(encoding="utf-8")).body):
            rooms = allowed.get(library)
            if rooms is not None and not any(f"{inside}.".startswith(f"{room}.") for room in rooms):
                found.append(f"{name} imports the heavy {library} as it is imported itself")
    return found


def _loaded(body: Sequence[ast.AST]) -> Iterator[str]:
    """Libraries that statements import when they run as part of a module, those for type checkers left out."""
    for node in body:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            yield node.module.partition(".")[0]
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            yield from _loaded(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _loaded(list(ast.iter_child_nodes(node)))
