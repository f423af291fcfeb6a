"""`stictionid report`: studies as markdown with pictures, one HTML page, JSON, or a table on the terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from ..record.planned_test import CSV_HEAD
from ..system.files import ensure_writable, keep_apart, write_whole
from .app import app, outcome
from .common.options import (
    EffectsOption,
    FiguresOption,
    ForceOption,
    JsonOption,
    LawsOption,
    OpLimits,
    PvLimits,
    QuietOption,
    limits_of,
)
from .common.output import Progress, out_console, print_json_text, say, say_written
from .common.study_files import open_study


@app.command(epilog=outcome("the report with -o, and pictures beside markdown", json="schema stictionid.report/1"),
             help="Write a report of one or more studies: markdown with pictures, one HTML page, or JSON.\n\n"
                  "Without -o it prints the result as a table.\n\n"
                  "Example: stictionid report study.json -o report.html")
def report(
    studies: Annotated[list[Path], typer.Argument(metavar="STUDY... [FILE]", help="Studies written by identify -o; "
                                                  "after one study its data file, when it has moved.")],
    out: Annotated[Path | None, typer.Option("--output", "-o", help="Report to write; .md, .html or .json.")] = None,
    figures: FiguresOption = "svg",
    data: Annotated[Path | None, typer.Option("--data", help="The data file (one study only).")] = None,
    op_limits: OpLimits = None, pv_limits: PvLimits = None,
    test_csv: Annotated[Path | None, typer.Option("--test-csv", metavar="FILE", rich_help_panel="Planned test",
                                                  help="Write the steps of the planned test as CSV.")] = None,
    effects: EffectsOption = None, laws: LawsOption = None,
    as_json: JsonOption = False,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Read the studies, find their data, re-run their models once, and write or print."""
    from ..reports.pages.json import report_json
    from ..reports.pages.write import check_target, write_report
    from ..reports.pictures.curves import gather
    from ..reports.pictures.gallery import pictures
    from ..verdict.planned_test import with_plan

    studies, data = _apart(studies, data)
    if data is not None and len(studies) > 1:
        raise UsageError(f"one data file was given, but there are {len(studies)} studies", "report them one by one")
    limits = limits_of(op_limits, pv_limits)
    if len(studies) > 1 and (test_csv is not None or any(limits.values())):
        raise UsageError(f"limits and steps of a test belong to one loop, but there are {len(studies)} studies",
                         "report them one by one")
    if out is not None:
        keep_apart(out, *studies, what="the study")
        if data is not None:
            keep_apart(out, data)
        check_target(out, figures=figures, force=force)
    if test_csv is not None:
        keep_apart(test_csv, *studies, *([data] if data is not None else []), what="an input")
        ensure_writable(test_csv, force=force, kind=CSV_HEAD.encode())
    written: list[Path] = []
    with Progress(quiet or as_json) as progress:
        cases = []
        for i, path in enumerate(studies):
            progress(f"reading the data of {path.name}", 0.6 * i / len(studies))
            case = gather(open_study(path), data=data, near=(path.resolve().parent,))
            cases.append(replace(case, study=with_plan(case.study, case.loop, **limits)))
        if out is not None:
            written = write_report(cases, out, figures=figures, force=force,
                                   progress=lambda text, share: progress(text, 0.6 + 0.4 * share))
    for case in cases:
        if case.missing:
            say(f"{case.study.data.name}: {case.missing}", quiet=quiet)
    if as_json:
        print_json_text(report_json(cases, [pictures(case) for case in cases]))
    if out is not None:
        say_written(out, written, quiet=quiet)
    elif not as_json:
        from .common.terminal import print_case

        console = out_console()
        for case in cases:
            print_case(case, console)
    if test_csv is not None:  # (last: where there is no test the report says why)
        _write_steps(cases[0].study, test_csv, force, quiet)


def _write_steps(study: Any, place: Path, force: bool, quiet: bool) -> None:
    """Write the steps of the planned test whole; UsageError for a study without one."""
    plan = study.planned_test
    if plan is None or not plan.moves:
        raise UsageError(f"there is no test to write to {place}: {plan.reason if plan else 'no answer is open'}",
                         "give wider --op-limits and --pv-limits" if plan else "leave --test-csv out")
    write_whole(place, plan.csv, force=force, kind=CSV_HEAD.encode())
    say(f"wrote {place}", quiet=quiet)


def _apart(given: list[Path], data: Path | None) -> tuple[list[Path], Path | None]:
    """The studies, and the data file behind the first of them: a study is JSON, and no data file is.

    UsageError for a second data file.
    """
    files = [path for path in given[1:] if _is_data(path)]
    if len(files) + (data is not None) > 1:
        raise UsageError("report takes one data file", "report the studies one by one")
    return [path for path in given if path not in files], files[0] if files else data


def _is_data(path: Path) -> bool:
    """True for a folder, and for a file that does not begin as JSON does; an absent one is taken for a study."""
    if path.is_dir():
        return True
    try:
        with open(path, "rb") as file:
            return not file.read(64).lstrip().startswith(b"{")
    except OSError:
        return False
