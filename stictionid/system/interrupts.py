"""Handlers of SIGINT and SIGTERM that raise exceptions and remember which signal came.

Compiled libraries may turn an exception raised inside an import or a callback into another one. Code that sees a
failure therefore asks `ended_by` for an interruption.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any

INTERRUPTED, TERMINATED = 130, 143
# Wait before a signal is sent again, after a callback has lost its exception. Unit: s.
_AGAIN = 0.02
_ended: list[int] = []
# True once an interruption is being handled. Set inline and first: a call would be a place for the next signal.
over = False


def install() -> None:
    """Make SIGINT raise KeyboardInterrupt and SIGTERM SystemExit, so that both clean up before the exit.

    A signal that the caller had ignored (a job in the background, nohup) stays ignored.
    """
    for number, handler in ((signal.SIGINT, _interrupt), (signal.SIGTERM, _terminate)):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)
    sys.unraisablehook = _unraisable


def finish() -> None:
    """Ignore further signals: the work is over, and a signal could only change the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def ended_by() -> int | None:
    """Exit code of the interruption that came, None without one."""
    return _ended[0] if _ended else None


def _unraisable(unraisable: Any) -> None:
    """Send a signal again a moment later, where its exception was lost in a callback of compiled code."""
    if _ended and isinstance(unraisable.exc_value, KeyboardInterrupt | SystemExit):
        number = signal.SIGINT if _ended[0] == INTERRUPTED else signal.SIGTERM
        again = threading.Timer(_AGAIN, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
        return
    sys.__unraisablehook__(unraisable)


def _interrupt(*_: Any) -> None:
    if over:
        return
    _ended.append(INTERRUPTED)
    raise KeyboardInterrupt


def _terminate(*_: Any) -> None:
    if over:
        return
    _ended.append(TERMINATED)
    raise SystemExit(TERMINATED)
