"""The program: `stictionid`, or `python -m stictionid`. Readies the process, then hands over to the command line.

Signals and standard streams are put in order before anything that takes time is loaded, so that an interruption while
libraries load is as quiet as one later on.
"""

from __future__ import annotations

import contextlib
import os
import sys

from .system import interrupts


def main() -> None:
    """Run the command line; SIGINT ends in exit code 130, SIGTERM in 143, neither with a traceback."""
    interrupts.install()
    try:
        _streams()
        from .cli import main as run

        run()
    except (KeyboardInterrupt, Exception):
        interrupts.over = True
        code = interrupts.ended_by()
        if code is None:
            raise
        if code == interrupts.INTERRUPTED:
            print("stictionid: interrupted", file=sys.stderr)
        sys.exit(code)
    finally:
        interrupts.over = True
        interrupts.finish()
        _leave_if_interrupted()


def _leave_if_interrupted() -> None:
    """End here with the code of the interruption.

    Where the exception once passed through code that a library runs as text, the interpreter remembers it as unhandled
    and kills itself by SIGINT on its way out (seen while numba loads), whatever the exit code.
    """
    code = interrupts.ended_by()
    if code is None:
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _streams() -> None:
    """Open what the caller closed (a file opened later would take its place), and never fail for a character."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    main()
