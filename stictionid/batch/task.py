"""Messages between the batch and its workers: one plain description each way, picklable and small."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..historian.bytes.options import ReadOptions
from ..options import Options
from ..selection.policy import Policy

LEVELS = ("screen", "identify", "diagnose", "study")
OK, ABSTAINED, FAILED, SKIPPED = "ok", "abstained", "failed", "skipped"


@dataclass(frozen=True, slots=True)
class Skipped:
    """One file that holds no loop: its path, the reason, and what to do about it."""

    file: str
    reason: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Task:
    """One loop to do: the place of its record, the options to read it, and the name of its study.

    `kind` is "file" (one file holds it), "part" (it is a sheet or struct of a file), "wide" or "dataset" (it is the
    columns or rows `select` of `path`), or "tags" (its `files` hold one tag each). `problem` is a fault known before
    work began. `have` is the fingerprint of the data behind an existing study that would be made the same way, `had`
    its status.
    """

    loop: str
    kind: str
    path: str
    reading: ReadOptions
    key: str
    command: str = ""
    select: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    problem: str = ""
    have: str | None = None
    had: str = OK


@dataclass(frozen=True, slots=True)
class Work:
    """Work on every loop: the level, the options of `identify`, the policy, and whether each loop gets an HTML page.

    `policy` None means the defaults; `policy_file` is the file that it was read from, if any.
    """

    level: str = "identify"
    options: Options = field(default_factory=Options)
    pages: bool = False
    policy: Policy | None = None
    policy_file: str = ""


@dataclass(frozen=True, slots=True)
class TaskOutcome:
    """Result of a task: the study's text, or why there is none; `kept` when the existing study still holds.

    `page` is its HTML page, if requested; `seconds` is the time by stage; `detail` the traceback of a defect; `version`
    that of the worker's program.
    """

    key: str
    status: str
    text: str | None = None
    message: str = ""
    kept: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    worker: str = ""
    detail: str = ""
    version: str = ""
    page: str | None = None
