"""The option `--effects`: files of user-written effects that a command loads before anything else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def _load(context: typer.Context, places: list[Path] | None) -> list[Path] | None:
    """Add the effects of files and folders to the catalogue, and name them to worker processes."""
    if not places or context.resilient_parsing:
        return places
    from ...effects import VARIABLE, use

    use(places)
    # Workers that are spawned read them from the environment, the only place they share with this process.
    have = os.environ.get(VARIABLE, "")
    os.environ[VARIABLE] = os.pathsep.join([*([have] if have else []), *(str(p.resolve()) for p in places)])
    return places


EffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE|FOLDER", callback=_load, is_eager=True, show_default=False,
                 help="User-written effects, Python files; repeatable. Their code is run.")]
