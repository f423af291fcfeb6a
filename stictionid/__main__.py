"""Entry point of the program, `stictionid` or `python -m stictionid`: prepare the process, then run the command line.

Signal handlers and standard streams are set before anything that takes time is loaded. An interruption while libraries
load is then as quiet as a later one.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import sys
import threading

from .system import interrupts

# New objects between two looks for circles of them. Python's own 700 makes the imports of a command a tenth slower.
_LOOK_FOR_CIRCLES = 50_000


def main() -> None:
    """Run the command line; SIGINT ends in exit code 130, SIGTERM in 143, neither with a traceback."""
    interrupts.install()
    gc.set_threshold(_LOOK_FOR_CIRCLES)
    code: object = 0
    try:
        _streams()
        from .cli import main as run

        run()
    except SystemExit as ended:
        if interrupts.ended_by() is not None:
            raise
        code = ended.code
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
    _leave(code)


def _leave(code: object) -> None:
    """Exit without taking the libraries down one by one, which takes as long as importing numba.

    Python's own exit is left to do where it has something to wait for: threads, processes, a stream that fails.
    """
    with contextlib.suppress(OSError, ValueError):
        children = getattr(sys.modules.get("multiprocessing.process"), "_children", ())
        if threading.active_count() == 1 and not children and isinstance(code, int):
            atexit._run_exitfuncs()
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            os._exit(code)
    sys.exit(code)  # type: ignore[arg-type]


def _leave_if_interrupted() -> None:
    """Exit at once with the code of the interruption, if there was one.

    The interpreter remembers an exception as unhandled where it passed through code that a library runs as text. It
    then kills itself by SIGINT at exit, whatever the exit code (seen while numba loads).
    """
    code = interrupts.ended_by()
    if code is None:
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _streams() -> None:
    """Open standard streams that the caller closed, and escape characters that their encoding lacks.

    A file opened later would otherwise take the number of a closed stream.
    """
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
