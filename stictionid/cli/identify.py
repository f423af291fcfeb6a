"""`stictionid identify`: S, J, process, errors and verdict of one loop."""

from __future__ import annotations

import shlex
import sys
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import typer

from ..historian.bytes.options import ReadOptions
from .app import app
from .common.outcomes import outcome
from .common.output import (
    MOST_JOBS,
    ForceOption,
    JsonOption,
    Progress,
    QuietOption,
    SeedOption,
    interval,
    number,
    out_console,
    plain_table,
    print_json,
    safe,
    say,
    warn_when_cold,
)
from .common.policy import BudgetOption, PolicyOption, policy_of
from .common.reading import FileArgument, read_file, reads_file
from .common.tree import print_equivalents, print_tree
from .common.user_files import EffectsOption, LawsOption


@app.command(epilog=outcome("the study with -o", json="schema stictionid.study/1", abstains=True,
                            strict="when the verdict is undecided or the model not adequate"))
@reads_file
def identify(
    file: FileArgument,
    reading: ReadOptions,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the study as JSON.")] = None,
    method: Annotated[str, typer.Option(help="auto, arx (the paper exactly: ARX and particle swarm), or one of those "
                                        "it compares itself with: one-parameter, ellipse, polynomial, jelali.")]
    = "auto",
    law: Annotated[str | None, typer.Option(help="Stiction law, see stictionid laws; all fits and ranks every one.",
                                            show_default="chen")] = None,
    with_effect: Annotated[list[str] | None, typer.Option("--with", metavar="EFFECT", help="Put an effect into the "
                                                          "model from the start; repeatable.")] = None,
    base_only: Annotated[bool, typer.Option("--base-only", help="Stop at the base model.")] = False,
    between: Annotated[str, typer.Option(help="What the output did between samples: auto, hold, corner, or "
                                         "decimated (an export slower than the controller's scan).")] = "auto",
    scan: Annotated[float, typer.Option(metavar="SECONDS", help="Scan of the controller, for an export slower than "
                                        "that.")] = 1.0,
    gain: Annotated[float | None, typer.Option(help="Known process gain, units of y per % of travel.")] = None,
    time_constant: Annotated[float | None, typer.Option(help="Known time constant in seconds.")] = None,
    dead_time: Annotated[float | None, typer.Option(help="Known dead time in seconds.")] = None,
    step_test: Annotated[str | None, typer.Option("--step-test", metavar="FILE", help="Open-loop step record: its "
                                                  "process becomes the fixed plant.")] = None,
    order: Annotated[int | None, typer.Option(help="Order of the difference equation (arx, jelali, one-parameter, "
                                              "polynomial).")] = None,
    delay: Annotated[int | None, typer.Option(help="Its delay in samples; scanned when left out.")] = None,
    policy: PolicyOption = None, budget: BudgetOption = None,
    seed: SeedOption = 0,
    jobs: Annotated[int, typer.Option(min=1, max=MOST_JOBS, help="Processes for work that can be split.")] = 1,
    tree: Annotated[bool, typer.Option("--tree", help="Show the models that were tried.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 4 when undecided or the model is not adequate.")]
    = False,
    effects: EffectsOption = None, laws: LawsOption = None,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Find S, J, the process and whether the valve sticks, from controller output and process value.

    Exit code 3 when the record can't tell; the study then says why.

    Example: stictionid identify sample_data/foptd.csv -o study.json
    """
    from ..fit.options import Options
    from ..methods.option_check import check_options
    from ..record.study import to_json
    from ..system.files import ensure_writable, keep_apart, write_whole

    if output is not None:
        keep_apart(output, file, *([step_test] if step_test is not None else []))
        ensure_writable(output, force=force, kind=b"{")
    fixed = {name: value for name, value in (("gain", gain), ("time_constant_s", time_constant),
                                             ("dead_time_s", dead_time)) if value is not None}
    options = Options(method, law, tuple(with_effect or ()), base_only, between, fixed, seed, order, delay,
                      "stictionid " + shlex.join(sys.argv[1:]), scan_s=scan)
    steered = policy_of(policy, budget)
    check_options(options, steered)
    if step_test is not None:
        options = _with_step_test(options, step_test, reading, quiet)
    loop = read_file(file, reading, quiet=quiet).loop
    warn_when_cold(quiet)
    from ..verbs.identify import identify as run

    with Progress(quiet or as_json) as progress:
        study = run(loop, options=options, policy=steered, progress=progress)
    if output is not None:
        write_whole(output, to_json(study), force=force, kind=b"{")
    if as_json:
        print_json(study)
    else:
        show(study, quiet, tree=tree)
        if output is not None:
            say(f"wrote {output}; next: stictionid report {output} -o report.md", quiet=quiet)
    if study.estimate is None:
        raise typer.Exit(3)
    if strict and (study.verdict.stiction == "undecided" or not study.adequate):
        raise typer.Exit(4)


def _with_step_test(options: Any, file: str, reading: ReadOptions, quiet: bool) -> Any:
    """The options with the process of a step record as their fixed plant, and a finding that says so."""
    from dataclasses import replace

    from ..errors import DataError, UsageError
    from ..methods.option_check import check_options
    from ..process.step_test import fit_step

    if options.fixed:
        given = ", ".join("--" + name.removesuffix("_s").replace("_", "-") for name in options.fixed)
        raise UsageError(f"--step-test and {given} both fix the process", "give one of them")
    # A step test is made by hand, so manual samples count; it has times of its own.
    whole = replace(reading, keep_manual=True, keep_startup=True, start=None, end=None)
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
    from ..record.controller import COMMAND_FINDINGS

    console = out_console()
    console.print(f"verdict: {study.verdict.stiction} (confidence {study.verdict.confidence:.2f})")
    console.print(f"because: {safe(study.verdict.reason)}")
    for finding in study.data.findings:
        if finding.code in COMMAND_FINDINGS:
            console.print(f"command: {safe(finding.statement)}")
    if study.estimate is None:
        return
    console.print(_estimate_table(study))
    console.print(_error_table(study))
    if study.laws:
        console.print(_law_table(study))
    if tree:
        print_tree(study, console)
    console.print(f"adequate: {'yes' if study.adequate else 'no'}, {study.adequate_reason}")
    if study.interval_caution:
        console.print(study.interval_caution)
    print_equivalents(study, console)
    for finding in study.steps[-1].findings:
        say(f"{finding.severity}: {finding.statement}", quiet=quiet)


def _estimate_table(study: Any) -> Any:
    e = study.estimate
    unit_y = study.data.units.get("process_value") or "unit of y"
    table = plain_table("estimate", "value", "90 % interval", "from position", title="estimate")
    seen = e.from_position
    table.add_row("S stickband plus deadband", number(e.S, e.unit), interval(e.S_interval),
                  number(seen.S, e.unit) if seen else "-")
    table.add_row("J slip jump", number(e.J, e.unit) if e.J_known else "unknown", interval(e.J_interval),
                  number(seen.J, e.unit) if seen else "-")
    per = " per s" if e.integrating else ""
    table.add_row("process gain", number(e.gain, f"{unit_y}/{e.unit}{per}"), interval(e.gain_interval), "-")
    for i, (lag, span) in enumerate(zip_longest(e.time_constants_s, e.time_constants_intervals)):
        table.add_row("time constant" if i == 0 else "second time constant", number(lag, "s"), interval(span), "-")
    table.add_row("dead time", number(e.dead_time_s, "s"), interval(e.dead_time_interval), "-")
    table.add_row("residual force at start", f"{e.initial_residual_force:.2f} of f_s", "-", "-")
    return table


def _error_table(study: Any) -> Any:
    unit = study.data.units.get("process_value") or "unit of y"
    table = plain_table("model", f"error ({safe(unit)})", "held out", "noise", "fit %", "restarts", title="error")
    for step in study.steps:
        e = step.error
        kind = "integrator" if step.model.get("process") == "integrator" else "first order"
        name = f"+ {step.added}" if step.added else f"base: {study.estimate.law}, {kind}"
        table.add_row(name, number(e.rmse), number(e.rmse_holdout), number(e.noise_sd), number(e.fit_percent, "", 3),
                      f"{step.restarts.agree} of {step.restarts.runs}")
    return table


def _law_table(study: Any) -> Any:
    """Laws best first; "alike" marks those that the record cannot tell from the best."""
    unit = study.data.units.get("process_value") or "unit of y"
    remarks: dict[str, Any] = {}
    for finding in study.steps[-1].findings:
        if finding.code in ("laws-alike", "laws-told-apart"):
            remarks = finding.evidence
    u = safe(study.estimate.unit)
    table = plain_table("law", f"S {u}", f"J {u}", "error", "held out", "",
                        title=f"laws, best first; errors in {safe(unit)}")
    for law in study.laws:
        marks = ["alike"] * (law.law in remarks.get("alike", ())) + ["kept"] * (law.law == remarks.get("kept"))
        table.add_row(law.law, number(law.S), number(law.J), number(law.rmse), number(law.rmse_holdout),
                      ", ".join(marks))
    return table
