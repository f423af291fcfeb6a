"""The program: `stictionid`, or `python -m stictionid`. Readies the process, then hands over to the command line.

Signals and standard streams are put in order before anything that takes time is loaded, so that an interruption while
libraries load is as quiet as one later on.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

INTERRUPTED, TERMINATED = 130, 143


def main() -> None:
    """Run the command line; SIGINT ends in exit code 130, SIGTERM in 143, neither with a traceback."""
    if hasattr(signal, "SIGTERM"):
        signal.signal(signal.SIGTERM, _terminate)
    try:
        _streams()
        from .cli import main as run

        run()
    except KeyboardInterrupt:
        print("stictionid: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _terminate(*_: Any) -> None:
    # As an exception, so that half-written temporary files are removed on the way out.
    raise SystemExit(TERMINATED)


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
