"""A command run in the test's own process: what a caller sees of it, without the second that a new process costs.

Signals, closed streams, full disks and the imports of a cold start are tested on processes of their own.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from stictionid.cli import main
from stictionid.system import interrupts

# A process that has not ended by then hangs, on the slowest and busiest machine too. Unit: s.
HANGS_S = 1800.0


@dataclass(frozen=True)
class Done:
    """A command that ended; the fields bear the names of subprocess.CompletedProcess."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments: object, cwd: Path | None = None, stdin: str = "", env: dict[str, str] | None = None) -> Done:
    """The command line with these arguments, its streams pipes in UTF-8; the working folder is put back afterwards."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="") for _ in range(2))
    given = io.TextIOWrapper(io.BytesIO(stdin.encode()), encoding="utf-8")
    over = interrupts.over
    code: object = 0
    with mock.patch.multiple(sys, argv=["stictionid", *map(str, arguments)], stdin=given, stdout=out, stderr=err), \
            mock.patch.dict(os.environ, env or {}), contextlib.chdir(cwd or Path.cwd()):
        try:
            main()
        except SystemExit as ended:
            code = ended.code or 0
        finally:
            interrupts.over = over
    texts = []
    for stream in (out, err):
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())  # type: ignore[attr-defined]
    assert isinstance(code, int)
    return Done(code, *texts)
