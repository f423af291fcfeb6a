"""`stictionid agree`: S and J of several records of one loop, their agreement, and their drift."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import DataError, UsageError
from ..historian.bytes.options import ReadOptions
from .app import app, outcome
from .common.options import (
    BaseOnlyOption,
    BetweenOption,
    EffectsOption,
    ForceOption,
    JsonOption,
    LawOption,
    LawsOption,
    QuietOption,
    ScanOption,
    SeedOption,
)
from .common.output import Progress, out_console, print_json, safe, say
from .common.reading import read_file, reads_file
from .common.study_tables import print_table


@app.command(epilog=outcome("the report with -o, and its picture beside markdown", json="the agreement",
                            abstains=True, strict="when the records do not agree"))
@reads_file
def agree(
    files: Annotated[list[str], typer.Argument(metavar="FILE...", show_default=False,
                                               help="Records of one loop: text, Parquet, workbook or MATLAB file.")],
    reading: ReadOptions,
    count: Annotated[int, typer.Option("--windows", metavar="N", help="Cut every file into N records of equal "
                                       "length.")] = 1,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Report to write: .md with its picture beside "
                                                "it, or .json.")] = None,
    figures: Annotated[str, typer.Option("--figures", help="Picture beside markdown: svg or png.")] = "svg",
    law: LawOption = None, base_only: BaseOnlyOption = False, between: BetweenOption = "auto", scan: ScanOption = 1.0,
    effects: EffectsOption = None, laws: LawsOption = None, seed: SeedOption = 0,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 4 when the records do not agree.")] = False,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Identify several records of one loop and say whether S and J agree within their intervals, and drift with time.

    Records that abstain are listed with the reason; exit code 3 when fewer than two can be compared.

    Several months of one loop: give one file for each.

    Where windows of one record differ, the time is said at which the valve changed, as when it was repaired.

    Example: stictionid agree sample_data/foptd_scanned.parquet --windows 3
    """
    from ..methods.option_check import check_options
    from ..options import ALL_LAWS, Options
    from ..reports.pages.agreement import check_place, write_agreement

    if output is not None:
        check_place(output, figures=figures, force=force)
    if law == ALL_LAWS:
        raise UsageError("--law all has no meaning for several records", "give one law, or leave it out")
    options = Options("auto", law, (), base_only, between, {}, seed, command="stictionid " + shlex.join(sys.argv[1:]),
                      scan_s=scan)
    check_options(options)
    with Progress(quiet or as_json) as progress:
        loops, unreadable = _read_all(files, reading, quiet, progress)
        from ..verbs.agree import cannot, compare_records

        found = compare_records(loops, count=count, options=options, unreadable=unreadable,
                                progress=lambda text, share: progress(text, 0.1 + 0.9 * share))
    if output is not None:
        written = write_agreement(found, output, figures=figures, force=force)
        say(f"wrote {output}" + (" and its picture beside it" if len(written) > 1 else ""), quiet=quiet)
    if as_json:
        print_json(found)
    else:
        _show(found, quiet)
    if cannot(found) is not None:
        raise typer.Exit(3)
    if strict and not found.agree:
        raise typer.Exit(4)


def _read_all(files: list[str], reading: ReadOptions, quiet: bool, progress: Any) -> tuple[list[Any], list[Any]]:
    """The loops that can be read, and the names of the others with the reason; DataError where none can."""
    loops, unreadable = [], []
    for i, file in enumerate(files):
        progress(f"reading {file}", 0.1 * i / len(files))
        try:
            loops.append(read_file(file, reading, quiet=quiet).loop)
        except DataError as error:
            unreadable.append((file, error))
    if not loops:
        raise unreadable[0][1]
    return loops, [(file, error.message) for file, error in unreadable]


def _show(found: Any, quiet: bool) -> None:
    """The agreement as tables on stdout, records that do not count on stderr."""
    from ..reports.pages.agreement import left_out, record_table

    console = out_console()
    rows = record_table(found)
    print_table(rows, console)
    for part in (*found.spreads, *found.drifts):
        console.print(safe(part.statement))
    console.print(f"answer: {safe(found.statement)}")
    for line in left_out(found):
        say(f"not counted: {line}", quiet=quiet)
