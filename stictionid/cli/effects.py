"""`stictionid effects`: the catalogue of physical effects, and template and contract test of user-written ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .app import app
from .common.outcomes import outcome
from .common.output import ForceOption, JsonOption, QuietOption, out_console, plain_table, print_json
from .common.user_files import EffectsOption, check_files, write_template


@app.command(epilog=outcome("nothing", json="a list of effects"))
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Show one effect in full.")] = None,
    new: Annotated[str | None, typer.Option("--new", metavar="NAME", help="Write a template of a user-written effect "
                                            "to -o FILE.py.")] = None,
    check: Annotated[list[Path] | None, typer.Option("--check", metavar="FILE", show_default=False, help="Run the "
                                                     "contract test of a user-written effect; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE.py", help="File of --new.")] = None,
    written: EffectsOption = None, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """List the physical effects with equation, parameters, units, source, and what they can't be told from.

    Example: stictionid effects extra-lag

    An effect of your own: stictionid effects --new worn-trim -o my_effect.py
    """
    from .. import effects as room

    if new is not None:
        from ..effects.written.template import template

        write_template(new, output, kind="effect", room=room, text=template, force=force, quiet=quiet)
        return
    if check:
        check_files(check, as_json, room=room, after="stictionid diagnose STUDY --apply --effects {file}")
        return

    chosen = [room.get(name)] if name else list(room.catalogue().values())
    if as_json:
        print_json([_plain(e) for e in chosen])
        return
    console = out_console()
    if name is None:
        table = plain_table("effect", "what", title="effects, in physical order")
        for e in chosen:
            table.add_row(e.name, e.summary)
        console.print(table)
        console.print("stictionid effects NAME shows one in full")
        return
    for key, value in _plain(chosen[0]).items():
        if key == "parameters":
            for p in value:
                console.print(f"  {p['name']} [{p['unit']}]: {p['meaning']}; {p['low']:g} to {p['high']:g}, "
                              f"neutral {p['neutral']:g}")
        else:
            console.print(f"{key.replace('_', ' ')}: {'; '.join(value) if isinstance(value, list) else value}")


def _plain(e: Any) -> dict[str, Any]:
    return {
        "name": e.name, "kind": e.kind, "place": e.place.name.lower(), "summary": e.summary, "equation": e.equation,
        "parameters": [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "neutral": p.neutral,
                        "meaning": p.meaning} for p in e.parameters],
        "variants": list(e.variants), "cannot_be_told_from": list(e.confused_with),
        "settled_by": e.settled_by, "told_apart": [f"{rival}: {words}" for rival, words in e.told_apart.items()],
        "source": e.source,
        "asked": e.asked, **({"file": e.file, "sha256": e.sha256} if e.file else {}),
    }
