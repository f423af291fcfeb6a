"""Code of users: Python files that a command line names, compiled and run once, under a time limit.

The command line, environment variables and installed packages name files; a study or a data file never does. Each fault
is one line with file, line and the next thing to do.
"""

from __future__ import annotations

import ast
import inspect
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

from ..errors import DataError, UsageError

# Longest time that a file may take to load and to pass its contract. Unit: s.
LIMIT_S = 10.0
# Time from one interruption to the next, for code that catches them, in s, and most lines that one waits.
_AGAIN_S, _LINES_ON = 0.05, 16
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class _Over(BaseException):
    """Interruption of a user's code, which no `except Exception` in it catches."""


def fault(file: str, line: int, words: str) -> DataError:
    """The refusal of a user's file in one line."""
    return DataError(f"{file}:{line}: {' '.join(words.split())}")


def line_in(error: BaseException, file: str) -> int:
    """Last line of a user's file that an error passed through; 1 where it passed through none."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file and f.lineno]
    return lines[-1] if lines else 1


def is_name(name: str) -> bool:
    """True for small letters, digits and hyphens."""
    return _NAME.fullmatch(name) is not None


def files_in(places: Collection[str | Path], kind: str) -> list[Path]:
    """Python files behind files and folders; UsageError for a place that is not there or holds none.

    `kind` is that of the catalogue's entries, "effect" or "law".
    """
    found: list[Path] = []
    for place in map(Path, places):
        if place.is_dir():
            inside = sorted(p for p in place.glob("*.py") if not p.name.startswith("_"))
            if not inside:
                raise UsageError(f"the folder {place} has no {kind} file", "give a folder with files that end in .py")
            found += inside
        elif place.is_file():
            found.append(place)
        else:
            raise UsageError(f"there is no {kind} file {place}",
                             f"stictionid {kind}s --new my-{kind} -o FILE.py writes a template")
    return found


@contextmanager
def limited(seconds: float, file: str) -> Iterator[None]:
    """Refuse a file whose code runs longer than this, with its line; no limit beside the main thread or on Windows."""
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    seen: list[int] = []

    def over(number: int, frame: FrameType | None) -> None:
        while frame is not None and frame.f_code.co_filename != file:
            frame = frame.f_back
        seen.append(frame.f_lineno if frame is not None else 1)
        if len(seen) == 1 or frame is None:
            raise _Over
        # A bare `except` caught the last one: the next is raised some lines on, until one falls outside its `try`.
        left = iter(range(len(seen) % _LINES_ON))

        def traced(here: FrameType, event: str, value: object) -> Any:
            if next(left, None) is None:
                raise _Over
            return traced

        frame.f_trace = traced
        sys.settrace(lambda *call: None)

    before, traced_before = signal.signal(signal.SIGALRM, over), sys.gettrace()
    signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN_S)
    try:
        yield
    except _Over:
        raise fault(file, seen[0],
                    f"it still runs after {seconds:g} s; look for a loop that does not end") from None
    finally:
        sys.settrace(traced_before)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _compiled(file: str, text: str) -> tuple[ast.Module, CodeType]:
    """Syntax tree and code of a file's text; DataError with the line that does not compile."""
    try:
        tree = ast.parse(text, file)
        return tree, compile(tree, file, "exec")
    except (SyntaxError, ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None) or 1
        raise fault(file, line, f"it does not compile ({getattr(error, 'msg', error)}); correct this line") from None


def _run(file: str, code: CodeType) -> ModuleType:
    """The module that the code makes; DataError with the line that fails."""
    module = ModuleType(Path(file).stem)
    module.__file__ = file
    try:
        with redirect_stdout(sys.stderr):
            exec(code, module.__dict__)
    except DataError:
        raise
    except (Exception, SystemExit) as error:
        raise fault(file, line_in(error, file),
                    f"it can't be imported ({type(error).__name__}: {error}); correct this line") from None
    return module


def opened(file: str, text: str, taken: Collection[str], kind: str,
           say: Callable[[str], None]) -> tuple[ModuleType, dict[str, int], str]:
    """The module of a file's text, the line of each constant that it assigns at its top, and its NAME or file name.

    DataError where it does not run, or where its name is none, or that of a built-in entry.
    """
    tree, code = _compiled(file, text)
    module = _run(file, code)
    say("it runs")
    lines = {target.id: node.lineno for node in tree.body if isinstance(node, ast.Assign)
             for target in node.targets if isinstance(target, ast.Name)}
    name, line = getattr(module, "NAME", Path(file).stem.replace("_", "-")), lines.get("NAME", 1)
    if not isinstance(name, str) or not is_name(name):
        raise fault(file, line, f"NAME {name!r} is no name; use small letters, digits and hyphens, \"worn-trim\"")
    if name in taken:
        raise fault(file, line, f"NAME {name} is that of a built-in {kind}; choose another one")
    return module, lines, name


def said_by(module: ModuleType, otherwise: str) -> tuple[str, str]:
    """First line of a user's docstring without its full stop, and the rest of it; `otherwise` where there is none."""
    first, *rest = (inspect.getdoc(module) or otherwise).strip().splitlines()
    return first.rstrip("."), " ".join(" ".join(rest).split())
