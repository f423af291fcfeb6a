"""Progress of a batch on stderr: a bar on a terminal, JSON lines with --json, a line now and then elsewhere."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from ...system.plurals import counted
from .output import err_console, say

# Seconds between two lines where stderr is no terminal.
_EVERY_S = 30.0


class Watch:
    """Receiver of every outcome; a context, so that the bar is removed whatever happens."""

    def __init__(self, total: int, *, as_json: bool, quiet: bool) -> None:
        self._json, self._quiet = as_json and not quiet, quiet
        self._bar: Any = None
        self._task: Any = None
        self._said = time.monotonic()
        if not quiet and not as_json and sys.stderr.isatty():
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

            self._bar = Progress(TextColumn("loops"), BarColumn(), MofNCompleteColumn(),
                                 TextColumn("{task.description}"), console=err_console(), transient=True)
            self._task = self._bar.add_task("starting", total=total)

    def __enter__(self) -> Watch:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, tally: Any, task: Any, out: Any) -> None:
        """Take one outcome, or (task None) a sign that work goes on."""
        if self._json and task is not None:
            self._line(tally, task, out)
        elif self._bar is not None:
            self._bar.update(self._task, completed=tally.done, description=_words(tally))
        elif not self._quiet and not self._json and time.monotonic() - self._said > _EVERY_S:
            self._said = time.monotonic()
            say(f"{tally.done} of {counted(tally.total, 'loop')}, {_words(tally)}")

    @staticmethod
    def _line(tally: Any, task: Any, out: Any) -> None:
        left = tally.left_s
        print(json.dumps({
            "event": "loop", "loop": task.loop, "status": out.status, "kept": out.kept, "message": out.message,
            "done": tally.done, "total": tally.total, "failed": tally.failed, "abstained": tally.abstained,
            "rate_per_s": round(tally.rate_per_s, 4), "left_s": None if left is None else round(left, 1),
            "worker": out.worker}), file=sys.stderr, flush=True)


def _words(tally: Any) -> str:
    left = tally.left_s
    return (f"{tally.failed} failed, {tally.abstained} abstained"
            + (f", {tally.kept} kept" if tally.kept else "") + f", {tally.rate_per_s:.2g} a second"
            + ("" if left is None else f", {_span(left)} left"))


def _span(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s" if rest >= 60 else f"{rest} s"
