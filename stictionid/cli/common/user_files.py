"""Template and contract test of user-written effects and laws, the files of `--effects` and `--laws`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...errors import UsageError
from ...system.files import write_whole
from ...system.user_code import is_name
from .output import out_console, print_json, safe, say


def write_template(name: str, output: Path | None, *, kind: str, room: Any, text: Callable[[str], str], force: bool,
                   quiet: bool) -> None:
    """Write the template of an effect or a law, the `kind`, and say what to do with it.

    UsageError for a name that is none or is taken, and for a place that is no Python file.
    """
    if not is_name(name):
        raise UsageError(f"'{name}' is no name for {'an' if kind[0] in 'aeiou' else 'a'} {kind}",
                         "use small letters, digits and hyphens: worn-trim")
    if name in room.catalogue():
        raise UsageError(f"there is {'an' if kind[0] in 'aeiou' else 'a'} {kind} {name} already",
                         "choose another name")
    if output is None or output.suffix != ".py":
        raise UsageError("--new writes a Python file", f"add -o {name.replace('-', '_')}.py")
    write_whole(output, text(name), force=force)
    say(f"wrote {output}; next: stictionid {kind}s --check {output}", quiet=quiet)


def check_files(files: list[Path], as_json: bool, *, room: Any, after: str) -> None:
    """Run the contract test of files and print every point that they pass; `after` says what to do next."""
    console, passed = out_console(), []
    for file in files:
        points: list[str] = []
        for entry in room.use([file], points.append if as_json else lambda words: console.print(f"ok: {safe(words)}")):
            passed.append({"file": str(file), "name": entry.name, "passed": points})
            if not as_json:
                console.print(f"{safe(str(file))} keeps the contract; next: "
                              f"{after.format(name=entry.name, file=safe(str(file)))}")
    if as_json:
        print_json(passed)
