"""Interruptions: SIGINT and SIGTERM as exceptions, and a memory of them.

Compiled libraries turn an exception that meets them half-way through an import or a callback into another one; whoever
then sees a failure asks `ended_by` whether it was an interruption.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any

INTERRUPTED, TERMINATED = 130, 143
# Wait before a signal is sent again whose exception a callback has swallowed. Unit: s.
_AGAIN = 0.02
_ended: list[int] = []
# Set, inline and before anything else, by whoever deals with an interruption: calls are where the next one strikes.
over = False


def install() -> None:
    """From now on SIGINT raises KeyboardInterrupt and SIGTERM SystemExit, so that both tidy up on their way out.

    A signal that the caller had ignored (a job in the background, nohup) stays ignored.
    """
    for name, handler in (("SIGINT", _interrupt), ("SIGTERM", _terminate)):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)
    sys.unraisablehook = _unraisable


def finish() -> None:
    """The work is over: a signal from now on could only change the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGTERM"):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def ended_by() -> int | None:
    """Exit code of the interruption that came, None without one."""
    return _ended[0] if _ended else None


def _unraisable(unraisable: Any) -> None:
    """An interruption that met a callback of compiled code is lost there: quietly send it again a moment later."""
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
