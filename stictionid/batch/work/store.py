"""The output folder: a study or a failure record per loop, each whole or absent.

    batch.json            origin of the folder: schema and version
    studies/NAME.json     one study per loop
    failures/NAME.json    why a loop has none (its older study, if any, stays but does not count)
    skipped.json          the files without a loop, each with reason and hint
    timing.csv            seconds per loop, one line added as each is done
    summary.*             made from the above, removed while a batch runs

A failure record is removed before the new study is written. A process that dies in between leaves a loop to repeat, and
never two answers.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..._version import __version__
from ...errors import DataError, UsageError
from ...historian.dataset import RESULTS_MARK
from ...system.csv_safety import harmless
from ...system.files import locked, unwritable, write_whole
from ..task import ABSTAINED, FAILED, OK, Skipped, Task, TaskOutcome

SCHEMA = "stictionid.batch/1"
FAILURE_SCHEMA = "stictionid.failure/1"
SKIPPED_SCHEMA = "stictionid.skipped/1"
_SKIPPED = "skipped.json"
SUMMARIES = ("summary.csv", "summary.parquet", "summary.md", "summary.html")
_TIMES = ("read", "screen", "identify", "diagnose", "page", "total")


class Store:
    """The folder of one batch. `begin` claims it, `keep` adds one outcome, `close` releases it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.studies, self.failures, self.pages = folder / "studies", folder / "failures", folder / "pages"
        self._lock: int | None = None

    def check(self, *, force: bool = False) -> None:
        """Refuse a foreign folder, or one of another or a newer version, before anything is touched.

        UsageError for a file, a foreign folder or another version (`force` accepts both folders), DataError for a newer
        schema.
        """
        if not self.folder.exists():
            parent = next(p for p in self.folder.absolute().parents if p.exists())
            if not parent.is_dir():
                raise UsageError(f"{parent} is a file, so {self.folder} can't be made", "choose another -o")
            return
        if not self.folder.is_dir():
            raise UsageError(f"{self.folder} is a file", "give a folder after -o")
        mark = self.folder / RESULTS_MARK
        if not mark.exists():
            if any(self.folder.iterdir()) and not force:
                raise UsageError(f"{self.folder} holds files that batch did not write",
                                 "choose a new folder with -o, or add --force to write among them")
            return
        self._check_mark(mark, force)

    def _check_mark(self, mark: Path, force: bool) -> None:
        try:
            said = json.loads(mark.read_text(encoding="utf-8"))
            schema, made = str(said["schema"]), str(said["version"])
        except (OSError, ValueError, KeyError, TypeError):
            if force:
                return
            raise UsageError(f"{mark} is damaged, so {self.folder} can't be told from another program's folder",
                             "choose another -o, or add --force") from None
        (kind, _, number), (own, _, newest) = schema.rpartition("/"), SCHEMA.rpartition("/")
        if kind == own and number.isdigit() and int(number) > int(newest):
            raise DataError(f"{self.folder} has schema {schema}, newer than {SCHEMA} that this version writes",
                            "update stictionid, or choose another -o")
        if made != __version__ and not force:
            raise UsageError(f"{self.folder} was written by stictionid {made}, this is {__version__}: their studies "
                             "can't stand in one summary",
                             "choose another -o, or add --force to leave the old ones out and do their loops again")

    def begin(self) -> None:
        """Make the folder, claim it and remove the summary until it can be true again. UsageError if that fails."""
        try:
            self.studies.mkdir(parents=True, exist_ok=True)
            self.failures.mkdir(exist_ok=True)
        except OSError as error:
            raise unwritable(self.folder, error) from None
        mark = self.folder / RESULTS_MARK
        text = json.dumps({"schema": SCHEMA, "version": __version__}) + "\n"
        if not mark.exists() or mark.read_bytes() != text.encode():
            write_whole(mark, text, force=True)
        try:
            self._lock = locked(mark, wait=False)
        except BlockingIOError:
            raise UsageError(f"another batch is writing to {self.folder}", "wait for it, or choose another -o") \
                from None
        if self._lock is not None:
            # No other batch writes here now: partial files are those of a killed batch.
            for place in (self.folder, self.studies, self.failures, self.pages):
                for part in place.glob(".*.part"):
                    part.unlink(missing_ok=True)
        for name in SUMMARIES:
            (self.folder / name).unlink(missing_ok=True)

    def close(self) -> None:
        """Release the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def standing(self, task: Task, *, pages: bool = False) -> tuple[str | None, str]:
        """SHA-256 of the data behind the task's study, if this version made it with the task's options; its status.

        With `pages` a study without its page does not count.
        """
        study = self._load(self.studies / f"{task.key}.json")
        lacks_page = pages and not (self.pages / f"{task.key}.html").exists()
        if study is None or lacks_page or (self.failures / f"{task.key}.json").exists():
            return None, OK
        data, status = study.get("data") or {}, status_of(study)
        same = ((study.get("created_by") or {}).get("version"), study.get("command"), data.get("name"))
        return (data.get("sha256"), status) if same == (__version__, task.command, task.loop) else (None, OK)

    def keep(self, task: Task, out: TaskOutcome) -> None:
        """Write the outcome of a task. UsageError where there is no room or no permission."""
        failure = self.failures / f"{task.key}.json"
        if out.kept:
            return
        if out.status == FAILED:
            record = {"schema": FAILURE_SCHEMA, "version": __version__, "loop": task.loop, "file": task.path,
                      "message": out.message, "command": task.command, "detail": out.detail}
            write_whole(failure, json.dumps(record, indent=1) + "\n", force=True)
        else:
            failure.unlink(missing_ok=True)
            # The page comes first: a study on disk then has its page, whatever stops the batch.
            page = self.pages / f"{task.key}.html"
            if out.page is not None:
                self.pages.mkdir(exist_ok=True)
                write_whole(page, out.page, force=True)
            else:
                page.unlink(missing_ok=True)
            write_whole(self.studies / f"{task.key}.json", out.text or "", force=True)
        self._time(task, out)

    def _time(self, task: Task, out: TaskOutcome) -> None:
        path = self.folder / "timing.csv"
        try:
            with open(path, "a", encoding="utf-8", newline="") as file:
                rows = csv.writer(file, lineterminator="\n")
                if file.tell() == 0:
                    rows.writerow(("loop", "status", *(f"{name}_s" for name in _TIMES), "worker"))
                rows.writerow((harmless(task.loop), out.status,
                               *(f"{out.seconds[n]:.4f}" if n in out.seconds else "" for n in _TIMES), out.worker))
        except OSError as error:
            raise unwritable(path, error) from None

    def skip(self, found: Iterable[Skipped], tasks: Iterable[Task]) -> None:
        """Write the files without a loop; those of earlier runs stay unless a task reads them now.

        UsageError where there is no room or no permission.
        """
        read = {path for t in tasks for path in (t.path, *t.files)}
        known = {s.file: s for s in (*self.skipped(), *found) if os.path.abspath(s.file) not in read}
        content = {"schema": SKIPPED_SCHEMA, "version": __version__, "files": [asdict(known[f]) for f in sorted(known)]}
        # A path may hold bytes that are no UTF-8.
        text = json.dumps(content, indent=1, ensure_ascii=True) + "\n"
        write_whole(self.folder / _SKIPPED, text, force=True)

    def skipped(self) -> list[Skipped]:
        """The files without a loop, by name."""
        content = self._load(self.folder / _SKIPPED) or {}
        if content.get("version") != __version__:
            return []
        return [Skipped(str(e.get("file")), str(e.get("reason")), str(e.get("hint") or ""))
                for e in content.get("files") or () if isinstance(e, dict)]

    def records(self) -> Iterator[tuple[str, dict[str, Any], bool]]:
        """Key, content and failure flag of every loop that this version has an answer for, by key."""
        failed = {p.stem for p in self.failures.glob("*.json")}
        for key in sorted(failed | {p.stem for p in self.studies.glob("*.json")}):
            failure = key in failed
            content = self._load((self.failures if failure else self.studies) / f"{key}.json")
            if content is None:
                continue
            made = content.get("version") if failure else (content.get("created_by") or {}).get("version")
            if made == __version__:
                yield key, content, failure

    @staticmethod
    def _load(path: Path) -> dict[str, Any] | None:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return content if isinstance(content, dict) else None


def status_of(study: dict[str, Any]) -> str:
    """Abstained where a study's verdict carries the code of a failed precondition, else ok."""
    evidence = (study.get("verdict") or {}).get("evidence") or {}
    return ABSTAINED if not study.get("estimate") and "code" in evidence else OK
