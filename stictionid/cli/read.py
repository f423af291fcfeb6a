"""`stictionid read`: the interpretation of an export, and the rows left out by reason."""

from typing import Annotated, Any

import typer

from ..errors import UsageError
from ..historian.bytes.options import ReadOptions
from ..system.files import ensure_writable, keep_apart
from ..system.plurals import counted
from .app import app, outcome
from .common.options import ForceOption, JsonOption, QuietOption
from .common.output import out_console, plain_table, print_json, safe, say
from .common.reading import FileArgument, read_file, reads_file

# Bars of a line.
_WIDTH = 48
_BARS = "▁▂▃▄▅▆▇█"
_PLAIN_BARS = "_.-~=+*#"


@app.command(epilog=outcome("the cleaned loop with -o, the profile with --save-profile", json="what was understood"))
@reads_file
def read(
    file: FileArgument,
    reading: ReadOptions,
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="CLEAN", help="Write the cleaned loop (.parquet or .csv).")
    ] = None,
    save_profile: Annotated[
        str | None, typer.Option("--save-profile", metavar="SITE.toml", help="Keep what was understood for --profile.")
    ] = None,
    json: JsonOption = False,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show what is understood of an export: roles, time, units, rows by reason, segments, findings.

    Example: stictionid read sample_data/foptd.csv
    """
    _check_targets(file, output, save_profile, force)
    result = read_file(file, reading, quiet=quiet)
    if output is not None:
        from ..historian.checks.clean import write_clean

        write_clean(result, output, force=force)
        say(f"wrote {output}", quiet=quiet)
    if save_profile is not None:
        from ..historian.profile import save_profile as save

        save(result, reading, save_profile, force=force)
        say(f"wrote {save_profile}", quiet=quiet)
    if json:
        print_json(_as_json(result))
    else:
        _show(result)


def _check_targets(file: str, output: str | None, save_profile: str | None, force: bool) -> None:
    """Refuse places that cannot be written before anything is read."""
    from ..historian.checks.clean import own_kind

    if output is not None:
        if not output.lower().endswith((".parquet", ".csv")):
            raise UsageError(f"-o {output} is neither .parquet nor .csv", "for example -o clean.parquet")
        keep_apart(output, file)
        ensure_writable(output, force=force, kind=own_kind(output))
    if save_profile is not None:
        ensure_writable(save_profile, force=force, kind=b"# stictionid")


def _as_json(result: Any) -> dict[str, Any]:
    """The reading as plain JSON types, without the arrays."""
    from dataclasses import fields

    from ..process.controller_words import as_read, steps_of
    from ..record.study import plain

    content = {f.name: getattr(result, f.name) for f in fields(result) if f.name != "loop"}
    loop = result.loop
    content |= {
        "name": loop.name,
        "samples_used": int(loop.used.sum()),
        "start": loop.origin.start,
        "end": loop.origin.end,
        "steps": steps_of(loop),
        "controller": as_read(loop),
        "rows_used": result.rows["used"],
        "rows_in": result.rows["in"],
    }
    return {"schema": "stictionid.reading/1", **plain(content)}


def _show(result: Any) -> None:
    console = out_console()
    table = plain_table("what", "understood", title=safe(result.file), pad_edge=True,
                        rows=[(what, safe(text)) for what, text in _lines(result)])
    table.show_header, table.columns[0].no_wrap = False, True
    console.print(table)
    always = dict.fromkeys(("in", "used", "bad", "filled", "manual", "saturated", "frozen", "duplicate"), 0)
    rows = [(reason, f"{count:,}", f"{100 * count / max(result.rows['in'], 1):.1f} %")
            for reason, count in {**always, **result.rows}.items()]
    console.print(plain_table("reason", "rows", "share", title="rows", pad_edge=True, rows=rows))


def _lines(result: Any) -> list[tuple[str, str]]:
    from ..historian.words.roles import unit_in
    from ..process.controller_words import as_read, steps_in_words, steps_of, words_of

    loop = result.loop
    lines = [("loop", loop.name), ("shape", _shape_text(result))]
    for role, column in result.columns.items():
        unit = "" if unit_in(column) == result.units.get(role) else result.units.get(role, "")
        why = result.why.get(role, "")
        lines.append((role.replace("_", " "), f"{column}{f' [{unit}]' if unit else ''}{f' ({why})' if why else ''}"))
    lines += [
        ("time format", result.time),
        ("zone", result.zone or ("none: seconds only" if (loop.origin.start or "").endswith(" s") else
                                 "none said (--zone): local time as it stands")),
        ("from, to", f"{loop.origin.start} to {loop.origin.end}"),
        ("step", f"{loop.step_s:.6g} s"),
    ]
    units = loop.unit("output", "%"), loop.unit("process_value")
    if recorded := steps_in_words(steps_of(loop), *units):
        lines.append(("recorded", recorded))
    if (controller := as_read(loop)) is not None:
        lines.append(("controller", words_of(controller, *units)))
    if result.mode_map:
        lines.append(("modes", ", ".join(f"{word} is {meaning}" for word, meaning in result.mode_map.items())))
    if result.quality:
        lines.append(("quality", result.quality))
    shown = result.segments[:5]
    more = f", … {len(result.segments) - 5} more" if len(result.segments) > 5 else ""
    lines += [
        ("samples", ", ".join(f"{n:,} {what}" for what, n in result.samples.items())),
        ("segments", ", ".join(f"{s['samples']:,} from {s['start']}" for s in shown) + more),
        ("trend PV", _trend(loop.process_value)),
        ("trend OP", _trend(loop.output)),
    ]
    if result.unused:
        lines.append(("not used", ", ".join(result.unused[:12]) + (" …" if len(result.unused) > 12 else "")))
    return lines


def _shape_text(result: Any) -> str:
    separator = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "pipes", " ": "blanks"}.get(result.separator, "")
    parts = [
        result.shape,
        f"separated by {separator}" if separator else "",
        f"decimal {'comma' if result.decimal == ',' else 'point'}" if separator else "",
        result.encoding,
        counted(result.header_lines, "header line") if separator else "",
    ]
    return ", ".join(p for p in parts if p)


def _trend(values: Any) -> str:
    """A line of bars over the whole record, with the lowest and the highest value."""
    import sys

    import numpy as np

    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    means = [
        float(np.mean(p[np.isfinite(p)])) if np.isfinite(p).any() else low
        for p in np.array_split(values, min(_WIDTH, values.size))
    ]
    encoding = (sys.stdout.encoding or "ascii").lower().replace("-", "")
    bars = _BARS if encoding.startswith("utf") else _PLAIN_BARS
    scale = (len(bars) - 1) / (high - low) if high > low else 0.0
    return "".join(bars[round((m - low) * scale)] for m in means) + f" {low:.5g} to {high:.5g}"
