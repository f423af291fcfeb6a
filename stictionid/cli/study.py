"""`stictionid study`: the whole story of one loop in one command, from the export to the page."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from ..historian.bytes.options import ReadOptions
from ..system.files import ensure_writable, keep_apart
from .app import app, outcome
from .common.options import (
    BetweenOption,
    BudgetOption,
    EffectsOption,
    FiguresOption,
    ForceOption,
    JobsOption,
    JsonOption,
    LawOption,
    LawsOption,
    PolicyOption,
    QuietOption,
    ScanOption,
    SeedOption,
    StrictOption,
    WithOption,
    policy_of,
)
from .common.output import Progress, cores, number, out_console, print_json, safe, say, say_written
from .common.reading import FileArgument, read_file, reads_file
from .common.study_tables import ladder_table, leave, print_answer, print_equivalents, print_plan, write_study

_PAGES = (".html", ".md")
# Share of the work before the report, and after the reading. Unit: 1.
_READ, _STUDIED = 0.05, 0.9


@app.command(epilog=outcome("the page and, under its name, the study: loop.html and loop.json", abstains=True,
                            json="schema stictionid.study/1",
                            strict="undecided with S and J, or a model that is not adequate"))
@reads_file
def study(
    file: FileArgument,
    reading: ReadOptions,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT", show_default=False,
                                         help="The page (.html or .md), the study (.json), or a folder for both.")],
    law: LawOption = None, with_effect: WithOption = None, between: BetweenOption = "auto", scan: ScanOption = 1.0,
    figures: FiguresOption = "svg",
    effects: EffectsOption = None, laws: LawsOption = None,
    policy: PolicyOption = None, budget: BudgetOption = None, seed: SeedOption = 0, jobs: JobsOption = None,
    strict: StrictOption = False,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Read, identify, diagnose --apply and report in one command: one page, and the study beside it.

    Example: stictionid study sample_data/foptd_scanned.parquet -o loop.html
    """
    from ..methods.option_check import check_options
    from ..options import ALL_LAWS, Options
    from ..reports.pages.write import check_target, write_report
    from ..reports.pictures.curves import Case, curves
    from ..verbs.diagnose import whole_study
    from ..verdict.planned_test import with_plan

    page, place = _places(output, file)
    keep_apart(page, file)
    keep_apart(place, file)
    if law == ALL_LAWS:
        raise UsageError("--law all has no meaning for a whole study", "give one law; stictionid identify ranks them")
    options = Options("auto", law, tuple(with_effect or ()), False, between, {}, seed, scan_s=scan,
                      command="stictionid " + shlex.join(sys.argv[1:]))
    steered = policy_of(policy, budget)
    check_options(options, steered)
    if page.parent == output:
        output.mkdir(parents=True, exist_ok=True)
    check_target(page, figures=figures, force=force)
    ensure_writable(place, force=force, kind=b"{")
    with Progress(quiet or as_json) as progress:
        progress("read", 0.0)
        loop = read_file(file, reading, quiet=quiet).loop
        found = whole_study(loop, options=options, policy=steered, jobs=jobs or cores(),
                            progress=lambda text, share: progress(text, _READ + (_STUDIED - _READ) * share),
                            tell=lambda stage, so_far: _tell(stage, so_far, quiet))
        found = with_plan(found, loop)
        write_study(found, place, force, quiet)
        written = write_report([Case(found, loop, tuple(curves(found, loop)))], page, figures=figures, force=force,
                               progress=lambda text, share: progress(f"report: {text}",
                                                                     _STUDIED + (1.0 - _STUDIED) * share))
    say_written(page, written, quiet=quiet)
    if as_json:
        print_json(found)
    else:
        _show(found)
    leave(found, strict)


def _places(output: Path, file: str) -> tuple[Path, Path]:
    """Places of the page and of the study; UsageError for a name that is neither of them nor a folder."""
    suffix = output.suffix.lower()
    if output.is_dir() or not suffix:
        name = "loop" if file == "-" else Path(file).name.split(".")[0] or "loop"
        return output / f"{name}.html", output / f"{name}.json"
    if suffix == ".json":
        return output.with_suffix(".html"), output
    if suffix not in _PAGES:
        raise UsageError(f"a study can't be written as '{output.name}'",
                         "end the name after -o in .html, .md or .json, or name a folder")
    return output, output.with_suffix(".json")


def _tell(stage: str, so_far: Any, quiet: bool) -> None:
    """One line at the end of a stage: the error so far beside the noise."""
    if not so_far.steps:
        say(f"{stage}: {so_far.verdict.stiction}", quiet=quiet)
        return
    last = so_far.steps[-1]
    names = " + ".join(["base", *(s.added for s in so_far.steps if s.added)])
    say(f"{stage}: {names}, error {number(last.error.best)}, noise {number(last.error.noise_sd)}", quiet=quiet)


def _show(found: Any) -> None:
    from ..reports.facts import said

    console = out_console()
    headline, then = said(found)
    for sentence in (headline, *then):
        console.print(safe(sentence))
    console.print(f"verdict: {found.verdict.stiction} (confidence {found.verdict.confidence:.2f})")
    console.print(f"because: {safe(found.verdict.reason)}")
    if found.estimate is not None:
        print_answer(found, console, applied=True)
        console.print(ladder_table(found))
        print_equivalents(found, console)
        print_plan(found, console)
