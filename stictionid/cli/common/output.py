"""Output shared by all commands: consoles, tables, JSON and progress.

Only data go to stdout; progress, findings, hints and errors go to stderr.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...reports.wording import DIRECTION_MARKS
from ...system import evaluations
from ...system.plurals import counted

if TYPE_CHECKING:
    from rich.console import Console

# Narrowest and widest table, and the width of a table that no terminal shows. Unit: columns.
_NARROWEST, _WIDEST, _PIPED = 60, 200, 80


def width_of(*, terminal: bool) -> int:
    """Columns of a table: those of the environment variable COLUMNS, else of the terminal, else 80; from 60 to 200."""
    asked = os.environ.get("COLUMNS", "")
    known = terminal or (asked.isdigit() and int(asked) > 0)
    found = shutil.get_terminal_size((_PIPED, 24)).columns if known else _PIPED
    return min(max(found, _NARROWEST), _WIDEST)


def out_console() -> Console:
    """Console on stdout: as wide as the terminal or COLUMNS, plain and 80 columns wide elsewhere."""
    from rich.console import Console

    class Pipe(Console):
        """A console that raises for a closed pipe, which main() handles (rich would exit with 1)."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Pipe(file=sys.stdout, highlight=False, soft_wrap=False, emoji=False, markup=False,
                width=width_of(terminal=sys.stdout.isatty()))


def err_console() -> Console:
    """Console on stderr."""
    from rich.console import Console

    return Console(file=sys.stderr, highlight=False, emoji=False, markup=False,
                   width=None if sys.stderr.isatty() else 200)


def safe(text: Any) -> str:
    """Text from a file made harmless for a terminal: control characters and direction marks become escapes."""
    return "".join(c if c.isprintable() and c not in DIRECTION_MARKS else c.encode("unicode_escape").decode()
                   for c in str(text))


def say(text: str, *, quiet: bool = False) -> None:
    """One line on stderr."""
    if not quiet:
        print(safe(text), file=sys.stderr)


def say_written(place: Path, written: Sequence[Path], *, quiet: bool) -> None:
    """One line on stderr that names a page and counts the pictures written beside it."""
    beside = f" and {counted(len(written) - 1, 'picture')} beside it" if len(written) > 1 else ""
    say(f"wrote {place}{beside}", quiet=quiet)


def can_write(text: str, encoding: str | None) -> bool:
    """True where an encoding, ASCII for None, has all characters of a text."""
    try:
        text.encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def print_json(value: Any) -> None:
    """A result as JSON on stdout."""
    from ...record.study import to_json

    print_json_text(to_json(value))


def print_json_text(text: str) -> None:
    """JSON on stdout, always as UTF-8 whatever the locale, as JSON demands."""
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(encoding="utf-8")
    sys.stdout.write(text)


def plain_table(*columns: str, rows: Iterable[Sequence[str]] = (), title: str = "",
                right: Collection[int] | None = None, lines: bool | None = None, pad_edge: bool = False) -> Any:
    """A table of some rows: light lines on a terminal, plain ASCII elsewhere.

    Columns `right` are right-aligned, by default all after the first of three or more. `lines` says that the output can
    draw light lines, by default where it is a terminal.
    """
    from rich import box
    from rich.table import Table

    if right is None:
        right = range(1, len(columns)) if len(columns) != 2 else ()
    light = sys.stdout.isatty() if lines is None else lines
    table = Table(title=title or None, title_justify="left", title_style="bold", pad_edge=pad_edge,
                  box=box.SIMPLE_HEAD if light else box.ASCII)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def number(value: float | None, unit: str = "", digits: int = 4) -> str:
    """A number with its unit for a table; a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" + (f" {unit}" if unit else "")


# Seconds between two lines of progress where stderr is no terminal, and before the same words stand there again.
_EVERY_S, _AGAIN_S = 5.0, 60.0
# Said before the first kernel that is compiled, where a plain record needs it and where only another one does.
FIRST_RUN = "first run: compiling the kernels, once per installation. This takes about 15 s of processor time, " \
            "shared by the cores; the first record that needs more of them compiles some more"
_FURTHER = "compiling further kernels, once per installation"


class Progress:
    """Progress on stderr: a bar on a terminal after a second, elsewhere a line for each stage, nothing when quiet.

    It goes on while models are evaluated, and says first which user-written effects are slow. It says where time goes
    into kernels that are compiled, once per installation.
    """

    def __init__(self, quiet: bool) -> None:
        self._start = time.monotonic()
        self._quiet, self._terminal = quiet, sys.stderr.isatty()
        self._said, self._words = self._start, ""
        self._bar: Any = None
        self._task: Any = None
        self._last: tuple[str, float] | None = None
        self._warned = False
        # Kernels compiled so far, and those of them that a line has named.
        self._compiled = self._told = 0

    def __call__(self, text: str, share: float) -> None:
        self._last = text, share
        if self._quiet or (self._bar is None and time.monotonic() - self._start < 1.0):
            return
        if not self._terminal:
            words = self._kernels() or f"{text}, {100.0 * share:.0f} %"
            wait = _AGAIN_S if words == self._words else _EVERY_S
            if time.monotonic() - self._said > wait and share < 1.0:
                self._said, self._words, self._told = time.monotonic(), words, self._compiled
                self._warn()
                say(f"{words} after {self._said - self._start:.0f} s")
            return
        if self._bar is None:
            self._warn()
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
                            TimeRemainingColumn(), console=err_console(), transient=True)
            self._bar.start()
            self._task = self._bar.add_task(text, total=1.0)
            # The bar appears after a second of work, which counts as elapsed time.
            self._bar.tasks[0].start_time -= time.monotonic() - self._start
        self._bar.update(self._task, description=self._kernels() or text, completed=share)
        self._told = self._compiled

    def _warn(self) -> None:
        """Name the slow effects, once."""
        from ...effects import added
        from ...effects.contract.written import SLOW, slowness

        for effect in () if self._warned else added().values():
            if effect.slower >= SLOW:
                say(slowness(effect))
        self._warned = True

    def _compiling(self, plain: bool) -> None:
        """Announce the first kernel that is compiled, and show at the next ones that the command still runs."""
        if not self._compiled:
            say(FIRST_RUN if plain else _FURTHER, quiet=self._quiet)
        self._compiled += 1
        self._beat()

    def _kernels(self) -> str:
        """Kernels compiled so far, in words, where some were since the last line; else nothing."""
        return f"{counted(self._compiled, 'kernel')} compiled" if self._compiled > self._told else ""

    def _beat(self) -> None:
        """Show the last words again where a stage takes long."""
        if self._last is not None and (self._bar is None or not self._terminal):
            self(*self._last)

    def __enter__(self) -> Progress:
        from ...numerics.machine_code import ahead

        evaluations.listeners.append(self._beat)
        ahead.listeners.append(self._compiling)
        return self

    def __exit__(self, *_: object) -> None:
        from ...numerics.machine_code import ahead

        evaluations.listeners.remove(self._beat)
        ahead.listeners.remove(self._compiling)
        if self._bar is not None:
            self._bar.stop()


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
