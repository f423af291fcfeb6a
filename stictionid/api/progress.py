"""Progress of a verb: a callback of the caller, or a bar in a notebook."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from html import escape
from typing import Any

from ..typing import Progress

# Seconds of work before a bar appears, and between two of its updates.
_AFTER_S, _EVERY_S = 1.0, 0.2


def teller(progress: Progress | None) -> Progress:
    """The callback given; without one a bar in a notebook, and nothing elsewhere."""
    if progress is not None:
        return progress
    display = _notebook()
    return (lambda text, share: None) if display is None else Bar(display)


def _notebook() -> Callable[..., Any] | None:
    """The display function of a running notebook; None elsewhere. IPython is looked at only where it is loaded."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None and hasattr(ipython, "get_ipython") else None
    if shell is None or not hasattr(shell, "kernel"):
        return None
    display: Callable[..., Any] = importlib.import_module("IPython.display").display
    return display


class Bar:
    """A bar below the cell, from a second of work on; it goes when the work is done."""

    def __init__(self, display: Callable[..., Any], clock: Callable[[], float] = time.monotonic) -> None:
        self._display, self._clock = display, clock
        self._begun, self._said = clock(), 0.0
        self._handle: Any = None

    def __call__(self, text: str, share: float) -> None:
        now = self._clock()
        if share >= 1.0:
            if self._handle is not None:
                self._handle.update({"text/html": "", "text/plain": ""}, raw=True)
            return
        if now - self._begun < _AFTER_S or (self._handle is not None and now - self._said < _EVERY_S):
            return
        self._said = now
        shown = {"text/html": f'<progress value="{share:.3f}" max="1"></progress> {escape(text)}',
                 "text/plain": f"{100 * share:.0f} % {text}"}
        if self._handle is None:
            self._handle = self._display(shown, raw=True, display_id=True)
        else:
            self._handle.update(shown, raw=True)
