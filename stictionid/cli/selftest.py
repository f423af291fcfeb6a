"""`stictionid selftest`: the tool's own rates on simulated loops, as a guide to what to trust."""

from __future__ import annotations

from typing import Annotated

import typer

from .app import app, outcome
from .common.options import JobsOption, JsonOption, QuietOption, SeedOption
from .common.output import Progress, cores, out_console, plain_table, print_json, safe


@app.command(epilog=outcome("nothing", json="rates, loops, passed", fails=True))
def selftest(
    quick: Annotated[bool, typer.Option("--quick", help="A handful of loops: a smoke test.")] = False,
    loops: Annotated[int | None, typer.Option("--loops", min=1, max=100_000, help="How many loops; 40 when left "
                                              "out.")] = None,
    jobs: JobsOption = None,
    seed: SeedOption = 0, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Identify and diagnose simulated loops whose truth is known; exit 1 when a rate is worse than chance allows.

    Example: stictionid selftest --quick
    """
    from ..system.plurals import counted
    from ..verbs.selftest import LOOPS, QUICK_LOOPS
    from ..verbs.selftest import selftest as run

    with Progress(quiet or as_json) as progress:
        found = run(loops=loops or (QUICK_LOOPS if quick else LOOPS), seed=seed, jobs=jobs or cores(),
                    progress=progress)
    if as_json:
        print_json(found)
    else:
        console = out_console()
        rates = [(r.name, f"{r.hits} of {r.of}", r.limit, "yes" if r.holds else "no") for r in found.rates]
        console.print(plain_table("rate", "loops", "must be", "holds", rows=rates,
                                  title=f"selftest on {counted(len(found.loops), 'loop')}"))
        for one in found.loops:
            if not one.right:
                said = ", ".join(one.named) or one.message or "nothing"
                console.print(f"seed {one.seed}: hidden {one.hidden or 'nothing'}, named {safe(said)}")
        console.print("passed" if found.passed else "failed: a rate is worse than chance allows")
    if not found.passed:
        raise typer.Exit(1)
