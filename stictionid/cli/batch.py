"""`stictionid batch`: many loops, local or on a cluster, with a summary that puts the worst first."""

from __future__ import annotations

import shlex
import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import StictionidError, UsageError
from ..historian.bytes.options import ReadOptions
from ..system.plurals import counted
from .app import app, outcome
from .common.batch_progress import Watch
from .common.completion import effect_names, law_names
from .common.options import (
    MOST_JOBS,
    BaseOnlyOption,
    BudgetOption,
    EffectsOption,
    JsonOption,
    LawsOption,
    NoIntervalsOption,
    PolicyOption,
    QuietOption,
    SeedOption,
    policy_of,
)
from .common.output import FIRST_RUN, cores, number, out_console, plain_table, print_json, safe, say
from .common.reading import reads_file

_SHOWN, _SKIPPED_SHOWN = 12, 5


@app.command(epilog=outcome("in DIR one study a loop (studies/), one page a loop with --pages or --level study "
                            "(pages/), summary.csv, summary.parquet, summary.md, summary.html, timing.csv, and "
                            "failures/ with reasons",
                            json="schema stictionid.batch/1", strict="when loops failed or files were skipped"))
@reads_file
def batch(
    paths: Annotated[list[str], typer.Argument(metavar="PATH...", show_default=False, help="Files, folders, patterns, "
                                               "or folders of partitioned Parquet.")],
    reading: ReadOptions,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", show_default=False,
                                         help="Folder for the studies and the summary.")],
    loops: Annotated[Path | None, typer.Option("--loops", metavar="LIST.csv", help="Loop list: loop, sp, pv, op, "
                                               "position, span_op, span_pv.")] = None,
    level: Annotated[str, typer.Option(help="screen (range and quick verdict), identify, diagnose (all of it), or "
                                           "study (all of it, and a page for every loop).")]
    = "identify",
    jobs: Annotated[int | None, typer.Option(min=1, max=MOST_JOBS, help="Worker processes.", show_default="cores")]
    = None,
    scheduler: Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT", help="Work on this Dask cluster.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Skip loops whose study still holds: same data, options and "
                                         "version.")] = False,
    method: Annotated[str, typer.Option(help="As in identify.")] = "auto",
    law: Annotated[str | None, typer.Option(autocompletion=law_names, show_default="chen",
                                            help="Stiction law; all fits and ranks every one.")] = None,
    with_effect: Annotated[list[str] | None, typer.Option("--with", metavar="EFFECT", autocompletion=effect_names,
                                                          help="Put an effect into every "
                                                          "model; repeatable.")] = None,
    base_only: BaseOnlyOption = False,
    no_intervals: NoIntervalsOption = False,
    between: Annotated[str, typer.Option(help="What the output did between samples: auto, hold or corner.")] = "auto",
    policy: PolicyOption = None, budget: BudgetOption = None,
    seed: SeedOption = 0,
    pages: Annotated[bool, typer.Option("--pages", help="One HTML report per loop, linked from summary.html.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 4 when loops failed or files were skipped.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write to a folder that is not empty, or of another version.")]
    = False,
    effects: EffectsOption = None, laws: LawsOption = None,
    as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Study many loops and rank them, worst first; one study per loop, and a summary of all.

    Loops are found by their tag names (FIC101.SP, .PV, .OP) in files, folders and Parquet datasets. Stopped by Ctrl-C
    or worse, it goes on with --resume.

    Example: stictionid batch sample_data --level screen -o site
    """
    from ..batch.plan.tasks import plan
    from ..batch.task import LEVELS, Work
    from ..batch.work.crew import crew_for
    from ..batch.work.store import Store
    from ..batch.work.warm import cold
    from ..methods.option_check import check_options
    from ..options import Options

    if level not in LEVELS:
        raise UsageError(f"unknown level '{level}'", "choose one of " + ", ".join(LEVELS))
    options = Options(method, law, tuple(with_effect or ()), base_only, between, seed=seed, intervals=not no_intervals)
    steered = policy_of(policy, budget)
    check_options(options, steered)
    work = Work(level, options, pages or level == "study", steered, str(policy.absolute()) if policy else "")
    _refuse_ignored(work)
    store = Store(output)
    store.check(force=force)
    crew = crew_for(jobs or cores(), scheduler)
    try:
        todo = plan(paths, work, reading=reading, loops=loops)
        _tell_plan(todo, quiet)
        if not scheduler and cold():
            say(FIRST_RUN, quiet=quiet)
        store.begin()
        store.skip(todo.skipped, todo.tasks)
        rows = _work_through(todo, work, crew, store, resume, Watch(len(todo.tasks), as_json=as_json, quiet=quiet))
    finally:
        crew.shutdown(wait=False, cancel_futures=True)
        store.close()
    _show(rows, todo, output, as_json, quiet)
    if strict and any(row["status"] in ("failed", "skipped") for row in rows):
        raise typer.Exit(4)


def _refuse_ignored(work: Any) -> None:
    """Refuse options that screening would ignore."""
    o = work.options
    for flag, given in (("--method", o.method != "auto"), ("--with", bool(o.effects)), ("--base-only", o.base_only),
                        ("--between", o.between != "auto"), ("--no-intervals", not o.intervals),
                        ("--law all", o.law == "all"),
                        ("--policy or --budget", work.policy is not None)):
        if work.level == "screen" and given:
            raise UsageError(f"{flag} has no meaning with --level screen", "leave it out, or use --level identify")
        if work.level in ("diagnose", "study") and given and flag == "--method":
            raise UsageError(f"--level {work.level} needs --method auto", "leave --method out, or use --level identify")


def _tell_plan(todo: Any, quiet: bool) -> None:
    some = len(todo.skipped)
    say(counted(len(todo.tasks), "loop") + (f", {counted(some, 'file')} skipped" if some else ""), quiet=quiet)
    for left in todo.skipped[:_SKIPPED_SHOWN]:
        say(f"skipped {left.file}: {left.reason}; {left.hint}", quiet=quiet)
    if some > _SKIPPED_SHOWN:
        say(f"skipped {some - _SKIPPED_SHOWN} more; the summary lists all", quiet=quiet)


def _work_through(todo: Any, work: Any, crew: Any, store: Any, resume: bool, watch: Watch) -> Any:
    """Drive to the end and summarise; interrupted, or out of room, summarise the results so far and say how to go on.
    """
    from ..batch.summary.page import write_summary
    from ..batch.summary.rows import counts_said
    from ..batch.work.drive import drive
    from ..batch.work.store import SUMMARIES

    try:
        with _terminable(), watch:
            drive(todo.tasks, work, crew, store, resume=resume, tell=watch)
        crew.shutdown()
    except KeyboardInterrupt:
        with _deaf():
            crew.shutdown(wait=False, cancel_futures=True)
            rows = write_summary(store)
            say(f"stictionid: interrupted; {store.folder} has {counts_said(rows)}")
            say(f"  go on with: {_again()}")
        raise typer.Exit(130) from None
    except StictionidError as error:
        crew.shutdown(wait=False, cancel_futures=True)
        try:
            write_summary(store)
        except StictionidError:  # no part of a summary is left that could not be written whole
            for name in SUMMARIES:
                (store.folder / name).unlink(missing_ok=True)
        error.hint = (error.hint + "; " if error.hint else "") + f"what is done is kept, go on with: {_again()}"
        raise
    return write_summary(store)


def _again() -> str:
    words = sys.argv[1:]
    return "stictionid " + shlex.join(words + ["--resume"] * ("--resume" not in words))


@contextmanager
def _terminable() -> Any:
    """SIGTERM stops a batch as Ctrl-C does."""
    def stop(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _deaf() -> Any:
    """Ignore a second Ctrl-C while the summary is written."""
    before = [(s, signal.signal(s, signal.SIG_IGN)) for s in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for s, handler in before:
            signal.signal(s, handler)


def _show(rows: Any, todo: Any, output: Path, as_json: bool, quiet: bool) -> None:
    from ..batch.summary.groups import groups_said
    from ..batch.summary.rows import counts_of, counts_said, shown
    from ..batch.work.store import SCHEMA

    counts = counts_of(rows)
    if as_json:
        print_json({"schema": SCHEMA, "output": str(output), "loops": len(rows) - counts["skipped"], **counts,
                    "skipped": todo.skipped, "rows": rows})
        return
    console = out_console()
    worst = [(safe(row["loop"]), row["status"], row["verdict"] or "-", number(row["S"]), number(row["J"]),
              shown(row, "period_median_s") or "-", safe(row["missing"] or "-")) for row in rows[:_SHOWN]]
    console.print(plain_table("loop", "status", "verdict", "S", "J", "period s", "missing", title="worst first",
                              rows=worst))
    if len(rows) > _SHOWN:
        console.print(f"{len(rows) - _SHOWN} more in {safe(output / 'summary.csv')}")
    console.print(counts_said(rows))
    for said in groups_said(rows):
        console.print(safe(said))
    for row in [r for r in rows if r["status"] == "failed"][:_SKIPPED_SHOWN]:
        say(f"failed: {row['loop']}: {row['message']}", quiet=quiet)
    others = len(rows) - counts["skipped"] - len({t.loop for t in todo.tasks})
    if others > 0:
        say(f"note: {counted(others, 'loop')} of the summary came from earlier runs into {output}", quiet=quiet)
    say(f"wrote {output}; next: open {output / 'summary.html'}", quiet=quiet)
