"""`stictionid compare`: where the model fails, in sentences with numbers and one picture per question."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from .app import app, outcome
from .common.next_step import next_step
from .common.options import EffectsOption, ForceOption, JsonOption, LawsOption, QuietOption
from .common.output import out_console, plain_table, print_json, safe, say, say_written
from .common.study_files import StudyArgument, open_data, open_other, open_study
from .common.study_tables import print_table


@app.command(epilog=outcome("the page with -o, and pictures beside markdown",
                            json="error, suspects, findings, adequate, series; of two studies: statement, errors, "
                                 "parameters"))
def compare(
    study: StudyArgument,
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Another record to validate on, or the study's "
                                                "own data file when it has moved.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Page with the pictures; .md or .html.")] = None,
    against: Annotated[Path | None, typer.Option("--against", metavar="OTHER", help="A second study to set beside "
                                                 "this one: another model, or another record.")] = None,
    series: Annotated[bool, typer.Option("--series", help="With --json: time, y, model, residual, position.")] = False,
    effects: EffectsOption = None, laws: LawsOption = None,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Hold the model against the measurement and say where it fails; a second FILE validates on other data.

    On another file what belongs to the plant is held (S, J, process, period of a wave). What belongs to the record is
    refitted: start state, bias, phase of a wave, time of a step.

    Two studies stand side by side with --against other.json.

    Example: stictionid compare study.json -o compare.html
    """
    from ..comparison import compare as run
    from ..reports.pages.comparison import check_place, write_comparison

    if output is not None:
        check_place(output, force=force)
    if against is not None:
        _against(study, against, file, output, force, as_json, quiet)
        return
    before = open_study(study)
    loop, other = open_other(before, study, file) if file else (open_data(before, study, None), None)
    found = run(loop, before, other)
    if output is not None:
        title = f"{before.data.name}: model against " + ("another record" if other is not None else "measurement")
        written = write_comparison(found, title, output, force=force)
        say_written(output, written, quiet=quiet)
    if as_json:
        print_json(_plain(found, series))
        return
    _print(found, before, study, quiet, data=file if other is None else None, effects=effects, laws=laws)


def _against(study: Path, other: Path, file: Path | None, output: Path | None, force: bool, as_json: bool,
             quiet: bool) -> None:
    """Set two studies side by side: print, page or JSON."""
    from ..comparison.side_by_side import side_by_side
    from ..reports.pages.comparison import write_beside
    from ..reports.pages.side_by_side import tables
    from ..reports.pictures.curves import gather

    if file is not None:
        raise UsageError("--against sets two studies side by side, so it takes no second record",
                         "leave one of them out")
    first, second = (gather(open_study(path), near=(path.resolve().parent,)) for path in (study, other))
    found = side_by_side(first.study, second.study)
    if output is not None:
        write_beside((first, second), found, output, force=force)
        say(f"wrote {output}", quiet=quiet)
    if as_json:
        print_json(found)
        return
    console = out_console()
    console.print(safe(found.statement))
    for t in tables(found):
        print_table(t, console)


def _plain(found: Any, series: bool) -> dict[str, Any]:
    g = found.ground
    curves = None
    if series:
        curves = {"time_s": g.loop.time_s, "y": g.loop.process_value, "model": g.evaluated.model,
                  "residual": g.evaluated.residual, "innovation": g.innovation, "position": g.evaluated.stem,
                  "output": g.loop.output, "setpoint": g.loop.setpoint, "counted": g.good}
    return {"error": found.error, "findings": found.findings, "adequate": found.adequate,
            "adequate_reason": found.adequate_reason, "notes": found.notes, "validates": found.validates,
            "suspects": found.suspects, "tables": found.tables, "unexplained": found.unexplained,
            "spectra": found.spectra, "series": curves}


def _print(found: Any, before: Any, study: Path, quiet: bool, **given: Any) -> None:
    from ..reports.pages.comparison import MOST_SUSPECTS, rows_of

    console = out_console()
    console.print(plain_table("error", "value", title="model against measurement",
                              rows=[(label, safe(value)) for label, value in rows_of(found)]))
    if found.suspects:
        table = plain_table("suspect", "findings", "speaks for it", title="suspects, best first",
                            rows=[(safe(s.effect), str(s.findings), safe(s.speaks_for))
                                  for s in found.suspects[:MOST_SUSPECTS]])
        table.columns[0].no_wrap, table.columns[-1].justify = True, "left"
        console.print(table)
    for f in found.findings:
        console.print(f"{f.severity}: {safe(f.statement)}")
    if not found.findings:
        console.print("no question shows a place where the model fails")
    for f in found.notes:
        console.print(f"{f.severity}: {safe(f.statement)}")
    console.print(("adequate: " if found.adequate else "not adequate: ") + safe(found.adequate_reason))
    if not found.validates:
        say(f"next: {next_step(before, study, **given)}", quiet=quiet)
