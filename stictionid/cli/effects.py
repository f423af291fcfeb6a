"""`stictionid effects`: the catalogue of physical effects."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from .app import app
from .common.output import JsonOption, out_console, plain_table, print_json


@app.command()
def effects(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Show one effect in full.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the physical effects with equation, parameters, units, source, and what they can't be told from.

    Example: stictionid effects extra-lag
    """
    from ..effects import catalogue, get

    chosen = [get(name)] if name else list(catalogue().values())
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
            console.print(f"{key.replace('_', ' ')}: {', '.join(value) if isinstance(value, list) else value}")


def _plain(e: Any) -> dict[str, Any]:
    return {
        "name": e.name, "kind": e.kind, "place": e.place.name.lower(), "summary": e.summary, "equation": e.equation,
        "parameters": [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "neutral": p.neutral,
                        "meaning": p.meaning} for p in e.parameters],
        "variants": list(e.variants), "cannot_be_told_from": list(e.confused_with), "source": e.source,
    }
