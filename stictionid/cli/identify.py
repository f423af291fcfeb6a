"""`stictionid identify`: S, J, process, errors and verdict of one loop."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import DataError, UsageError
from ..historian.bytes.options import ReadOptions
from ..record.controller import COMMAND_FINDINGS, LEFT
from ..system.files import keep_apart, write_whole
from .app import app, outcome
from .common.completion import law_names
from .common.next_step import next_step
from .common.options import (
    MOST_JOBS,
    BaseOnlyOption,
    BudgetOption,
    EffectsOption,
    ForceOption,
    JsonOption,
    LawsOption,
    NoIntervalsOption,
    OpLimits,
    PolicyOption,
    PvLimits,
    QuietOption,
    SeedOption,
    StrictOption,
    WithOption,
    limits_of,
    policy_of,
)
from .common.output import Progress, number, out_console, plain_table, print_json, safe, say
from .common.reading import FileArgument, read_file, reads_file
from .common.study_files import check_study_place
from .common.study_tables import held_out_words, leave, print_equivalents, print_plan, print_tree


@app.command(epilog=outcome("the study with -o", json="schema stictionid.study/1", abstains=True,
                            strict="undecided with S and J, or a model that is not adequate"))
@reads_file
def identify(
    file: FileArgument,
    reading: ReadOptions,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the study as JSON.")] = None,
    method: Annotated[str, typer.Option(help="auto, arx (Shang et al.: ARX and particle swarm), or one of those "
                                        "it compares itself with: one-parameter, ellipse, polynomial, jelali.")]
    = "auto",
    law: Annotated[str | None, typer.Option(autocompletion=law_names, show_default="chen", help="Stiction law, see "
                                            "stictionid laws; all fits and ranks every one.")] = None,
    with_effect: WithOption = None, base_only: BaseOnlyOption = False,
    no_intervals: NoIntervalsOption = False,
    between: Annotated[str, typer.Option(help="What the output did between samples: auto, hold, corner, or "
                                         "decimated (an export slower than the controller's scan).")] = "auto",
    scan: Annotated[float, typer.Option(metavar="SECONDS", help="Scan of the controller, for an export slower than "
                                        "that.")] = 1.0,
    gain: Annotated[float | None, typer.Option(help="Known process gain, units of y per % of travel.")] = None,
    time_constant: Annotated[float | None, typer.Option(help="Known time constant in seconds.")] = None,
    dead_time: Annotated[float | None, typer.Option(help="Known dead time in seconds.")] = None,
    step_test: Annotated[str | None, typer.Option("--step-test", metavar="FILE", help="Open-loop step record: its "
                                                  "process becomes the fixed plant.")] = None,
    test: Annotated[str | None, typer.Option("--test", metavar="steps", help="FILE is a manual test: OP was stepped by "
                                             "hand in open loop.")] = None,
    order: Annotated[int | None, typer.Option(help="Order of the difference equation (arx, jelali, one-parameter, "
                                              "polynomial).")] = None,
    delay: Annotated[int | None, typer.Option(help="Its delay in samples; scanned when left out.")] = None,
    op_limits: OpLimits = None, pv_limits: PvLimits = None,
    policy: PolicyOption = None, budget: BudgetOption = None,
    seed: SeedOption = 0,
    jobs: Annotated[int, typer.Option(min=1, max=MOST_JOBS, help="Processes for work that can be split.")] = 1,
    tree: Annotated[bool, typer.Option("--tree", help="Show the models that were tried.")] = False,
    strict: StrictOption = False,
    effects: EffectsOption = None, laws: LawsOption = None,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Find S, J, the process and whether the valve sticks, from controller output and process value.

    A record that holds too little ends with exit code 3: no S and J, and the reason (abstained). Undecided with S and
    J ends with 0, and with --strict with 4.

    Example: stictionid identify sample_data/foptd.csv -o study.json
    """
    from ..methods.option_check import check_options
    from ..options import Options
    from ..record.study import to_json

    if output is not None:
        keep_apart(output, file, *([step_test] if step_test is not None else []))
        check_study_place(output, force=force)
    fixed = {name: value for name, value in (("gain", gain), ("time_constant_s", time_constant),
                                             ("dead_time_s", dead_time)) if value is not None}
    options = Options(method, law, tuple(with_effect or ()), base_only, between, fixed, seed, order, delay,
                      "stictionid " + shlex.join(sys.argv[1:]), scan_s=scan, test=test, intervals=not no_intervals)
    limits = limits_of(op_limits, pv_limits)
    steered = policy_of(policy, budget)
    check_options(options, steered)
    if step_test is not None:
        options = _with_step_test(options, step_test, reading, quiet)
    loop = read_file(file, _by_hand(reading) if test is not None else reading, quiet=quiet).loop
    from ..verbs.identify import identify as run
    from ..verdict.planned_test import with_plan

    with Progress(quiet or as_json) as progress:
        study = with_plan(run(loop, options=options, policy=steered, progress=progress), loop, **limits)
    if output is not None:
        write_whole(output, to_json(study), force=force, kind=b"{")
    if as_json:
        print_json(study)
    else:
        show(study, quiet, tree=tree)
        if output is not None:
            say(f"wrote {output}", quiet=quiet)
            say(f"next: {next_step(study, output, effects=effects, laws=laws)}", quiet=quiet)
        elif file != "-":
            kept = shlex.quote(f"{Path(file).stem or 'study'}.json")
            say(f"next: {options.command} -o {kept}", quiet=quiet)
    leave(study, strict)


def _by_hand(reading: ReadOptions) -> ReadOptions:
    """The reading of a test made by hand: its samples in manual count."""
    return replace(reading, keep_manual=True, keep_startup=True)


def _with_step_test(options: Any, file: str, reading: ReadOptions, quiet: bool) -> Any:
    """The options with the process of a step record as their fixed plant, and a finding that says so."""
    from ..methods.option_check import check_options
    from ..process.step_test import fit_step

    if options.fixed:
        given = ", ".join("--" + name.removesuffix("_s").replace("_", "-") for name in options.fixed)
        raise UsageError(f"--step-test and {given} both fix the process", "give one of them")
    # It has times of its own.
    whole = replace(_by_hand(reading), start=None, end=None)
    test = read_file(file, whole, quiet=quiet).loop
    try:
        found = fit_step(test)
    except DataError as error:
        raise DataError(f"--step-test {file}: {error.message}", error.hint) from None
    finding = found.finding(Path(file).name)
    say(f"note: {finding.statement}", quiet=quiet)
    options = replace(options, fixed=found.fixed, notes=(*options.notes, finding))
    check_options(options)
    return options


def show(study: Any, quiet: bool, *, tree: bool = False) -> None:
    """The study as tables on stdout, the models tried among them if asked for; findings on stderr."""
    from ..reports.facts import position_sentences, size

    console = out_console()
    console.print(f"verdict: {study.verdict.stiction} (confidence {study.verdict.confidence:.2f})")
    if study.estimate is not None:
        if study.verdict.stiction != "no stiction":
            console.print(safe(size(study.estimate)))
        console.print(f"adequate: {'yes' if study.adequate else 'no'}, {safe(study.adequate_reason)}")
    console.print(f"because: {safe(study.verdict.reason)}")
    for finding in study.data.findings:
        # The reason of the model begins with digits that are lost.
        if finding.code in COMMAND_FINDINGS and finding.code != LEFT:
            console.print(f"command: {safe(finding.statement)}")
    if study.estimate is None:
        return
    console.print(_estimate_table(study))
    console.print(_error_table(study))
    if study.laws:
        console.print(_law_table(study))
    if tree:
        print_tree(study, console)
    if study.interval_caution:
        console.print(study.interval_caution)
    for sentence in position_sentences(study):
        console.print(safe(sentence))
    print_equivalents(study, console)
    print_plan(study, console)
    for finding in study.steps[-1].findings:
        say(f"{finding.severity}: {finding.statement}", quiet=quiet)


def _estimate_table(study: Any) -> Any:
    """The main values with their intervals, in the digits of every other output."""
    from ..reports import wording

    e = study.estimate
    unit_y = study.data.units.get("process_value") or "unit of y"

    def row(label: str, value: float, unit: str, span: tuple[float, float] | None, seen: float | None = None,
            pieces: Any = None) -> tuple[str, ...]:
        shown, ends = wording.apart(value, span, pieces)
        return label, f"{shown} {safe(unit)}", ends, number(seen, e.unit)

    seen = e.from_position
    value, ends = wording.jump_apart(e.J, e.J_interval, e.J_pieces, known=e.J_known)
    rows = [row("S stickband plus deadband", e.S, e.unit, e.S_interval, seen.S if seen else None, e.S_pieces),
            ("J slip jump", f"{value} {safe(e.unit)}" if e.J_known else value,
             ends if e.J_known or e.J_interval is None else f"{ends} {safe(e.unit)}",
             number(seen.J if seen else None, e.unit))]
    if e.scatter is not None and e.scatter.interval is not None:
        low, high = e.scatter.interval
        rows.append(row("scatter of f_s", e.scatter.value, e.scatter.unit, e.scatter.interval) if low > 0.0 else
                    ("scatter of f_s", f"below {number(high)} {safe(e.scatter.unit)}", "-", "-"))
    rows += [
        row("process gain", e.gain, f"{unit_y}/{e.unit}{' per s' if e.integrating else ''}", e.gain_interval),
        *(row("second time constant" if i else "time constant", lag, "s", span) for i, (lag, span) in
          enumerate(zip_longest(e.time_constants_s, e.time_constants_intervals))),
        row("dead time", e.dead_time_s, "s", e.dead_time_interval),
        ("residual force at start", f"{e.initial_residual_force:.2f} of f_s", "-", "-")]
    return plain_table("estimate", "value", "90 % interval", "from position", title="estimate", rows=rows)


def _error_table(study: Any) -> Any:
    unit = study.data.units.get("process_value") or "unit of y"
    table = plain_table("model", f"error ({safe(unit)})", "held out", "noise", "fit %", "restarts", title="error")
    for step in study.steps:
        e = step.error
        kind = "integrator" if step.model.get("process") == "integrator" else "first order"
        name = f"+ {step.added}" if step.added else f"base: {study.estimate.law}, {kind}"
        table.add_row(name, number(e.best), held_out_words(step), number(e.noise_sd), number(e.fit_percent, "", 3),
                      f"{step.restarts.agree} of {step.restarts.runs}")
        if e.rmse_path is not None:
            table.add_row("  slips by OP alone", number(e.rmse), "", "", "", "")
    return table


def _law_table(study: Any) -> Any:
    """Laws best first; "alike" marks those that the record cannot tell from the best."""
    unit = study.data.units.get("process_value") or "unit of y"
    told = next((f.laws for f in study.steps[-1].findings if f.laws is not None), None)
    alike, kept = (told.alike, told.kept) if told is not None else ((), "")
    u = safe(study.estimate.unit)
    rows = [(law.law, number(law.S), number(law.J), number(law.rmse), number(law.rmse_holdout),
             ", ".join(["alike"] * (law.law in alike) + ["kept"] * (law.law == kept))) for law in study.laws]
    return plain_table("law", f"S {u}", f"J {u}", "error", "held out", "", rows=rows,
                       title=f"laws, best first; errors in {safe(unit)}")
