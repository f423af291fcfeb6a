"""The options `--effects` and `--laws`, and template and contract test of the files that they name."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ...errors import UsageError
from ...system.files import write_whole
from ...system.user_code import is_name
from .output import out_console, print_json, safe, say


def _load_effects(context: typer.Context, places: list[Path] | None) -> list[Path] | None:
    return _load(context, places, "effects")


def _load_laws(context: typer.Context, places: list[Path] | None) -> list[Path] | None:
    return _load(context, places, "laws")


def _load(context: typer.Context, places: list[Path] | None, catalogue: str) -> list[Path] | None:
    """Add the entries of files and folders to a catalogue, and name them to worker processes."""
    if not places or context.resilient_parsing:
        return places  # the catalogues take a second to load, which help and completion do without
    room = importlib.import_module(f"stictionid.{catalogue}")
    room.use(places)
    # Workers that are spawned read them from the environment, the only place they share with this process.
    have = os.environ.get(room.VARIABLE, "")
    os.environ[room.VARIABLE] = os.pathsep.join([*([have] if have else []), *(str(p.resolve()) for p in places)])
    return places


EffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE|FOLDER", callback=_load_effects, is_eager=True, show_default=False,
                 help="User-written effects, Python files; repeatable. Their code is run.")]
LawsOption = Annotated[
    list[Path] | None,
    typer.Option("--laws", metavar="FILE|FOLDER", callback=_load_laws, is_eager=True, show_default=False,
                 help="User-written stiction laws, Python files; repeatable. Their code is run.")]


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
