"""`stictionid effects`: the catalogue of physical effects, and template and contract test of user-written ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from ..system.files import ensure_writable, write_whole
from .app import app, outcome
from .common.completion import effect_names
from .common.options import EffectsOption, ForceOption, JsonOption, QuietOption
from .common.output import out_console, plain_table, print_json, say
from .common.user_files import check_files, write_template


@app.command(epilog=outcome("nothing", json="a list of effects"))
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", autocompletion=effect_names,
                                                help="Show one effect in full.")] = None,
    new: Annotated[str | None, typer.Option("--new", metavar="NAME", help="Write a template of a user-written effect "
                                            "to -o FILE.py.")] = None,
    check: Annotated[list[Path] | None, typer.Option("--check", metavar="FILE", show_default=False, help="Run the "
                                                     "contract test of a user-written effect; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE.py", help="File of --new.")] = None,
    picture: Annotated[Path | None, typer.Option("--picture", metavar="OUT", help="Draw the effect on valve, PV "
                                                 "and residual of a standard loop, .svg or .png.")] = None,
    written: EffectsOption = None, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """List the physical effects with equation, parameters, units, source, and what they can't be told from.

    Example: stictionid effects extra-lag

    What it does to a loop: stictionid effects extra-lag --picture lag.svg

    An effect of your own: stictionid effects --new worn-trim -o my_effect.py
    """
    from .. import effects as room

    if new is not None:
        from ..effects.contract.template import template

        write_template(new, output, kind="effect", room=room, text=template, force=force, quiet=quiet)
        return
    if check:
        check_files(check, as_json, room=room, after="stictionid diagnose STUDY --apply --effects {file}")
        return
    if picture is not None:
        _draw(name, picture, force, quiet)
        return

    chosen = [room.get(name)] if name else list(room.catalogue().values())
    if as_json:
        print_json([_plain(e) for e in chosen])
        return
    console = out_console()
    if name is None:
        console.print(plain_table("effect", "what", title="effects, in physical order",
                                  rows=[(e.name, e.summary) for e in chosen]))
        console.print("stictionid effects NAME shows one in full")
        return
    for key, value in _plain(chosen[0]).items():
        if key == "parameters":
            for p in value:
                console.print(f"  {p['name']} [{p['unit']}]: {p['meaning']}; {p['low']:g} to {p['high']:g}, "
                              f"neutral {p['neutral']:g}")
        else:
            console.print(f"{key.replace('_', ' ')}: {'; '.join(value) if isinstance(value, list) else value}")


def _draw(name: str | None, out: Path, force: bool, quiet: bool) -> None:
    """Draw one effect on the standard loop."""
    from ..reports.pages.atlas import atlas_picture
    from ..reports.pictures.figures import PNG_KIND, figure_bytes
    from ..reports.pictures.svg import SVG_KIND

    kinds = {".svg": SVG_KIND, ".png": PNG_KIND}
    kind = out.suffix.lower()
    if name is None or kind not in kinds:
        raise UsageError("--picture draws one effect as .svg or .png",
                         "type for example: stictionid effects extra-lag --picture lag.svg")
    ensure_writable(out, force=force, kind=kinds[kind])
    drawn = atlas_picture(name)
    write_whole(out, figure_bytes(drawn, kind[1:]), force=force, kind=kinds[kind])
    say(f"wrote {out}: {drawn.alt}", quiet=quiet)


def _plain(e: Any) -> dict[str, Any]:
    return {
        "name": e.name, "kind": e.kind, "place": e.place.name.lower(), "summary": e.summary, "equation": e.equation,
        "noun": e.noun, "sentence": e.sentence, "action": e.action, "seen_over": e.seen_over,
        "parameters": [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "neutral": p.neutral,
                        "meaning": p.meaning} for p in e.parameters],
        "variants": list(e.variants), "cannot_be_told_from": list(e.confused_with),
        "settled_by": e.settled_by, "told_apart": [f"{rival}: {words}" for rival, words in e.told_apart.items()],
        "source": e.source,
        "asked": e.asked, **({"file": e.file, "sha256": e.sha256} if e.file else {}),
    }
