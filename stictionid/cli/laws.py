"""`stictionid laws`: the stiction laws with their equations, sources and limits, and a test bench for each."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UsageError
from ..system.files import ensure_writable, write_whole
from .app import app, outcome
from .common.completion import law_names
from .common.law_option import forces, from_forces, parse_law
from .common.options import ForceOption, JsonOption, LawsOption, QuietOption
from .common.output import out_console, print_json, say
from .common.user_files import check_files, write_template

if TYPE_CHECKING:
    from ..laws.contract import Law
    from ..model.valve_bench import BenchOutcome



@app.command(epilog=outcome("the picture of the bench, or the template of --new, with -o",
                            json="a law, a list of laws, or the bench's outcome"),
             help="List the stiction laws, show one in full, or put one on the valve test bench.\n\n"
                  "Example: stictionid laws --test choudhury -o bench.png\n\n"
                  "Example: stictionid laws he --test ramp --S 4 --J 2\n\n"
                  "Example: stictionid laws --test karnopp:mass=2,F_s=220,F_c=60")
def laws(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", autocompletion=law_names,
                                                help="A law, shown in full.")] = None,
    test: Annotated[str | None, typer.Option("--test", metavar="NAME", autocompletion=law_names,
                                              help="Bench: the law to test; or, after a "
                                             "law, one test's name or 'all'. Numbers of its own after a colon, "
                                             "forces F_s and F_c in N in place of S and J.")] = None,
    S: Annotated[float, typer.Option("--S", help="Stickband plus deadband on the bench, %.")] = 5.0,
    J: Annotated[float, typer.Option("--J", help="Slip jump on the bench, %.")] = 3.0,
    new: Annotated[str | None, typer.Option("--new", metavar="NAME", help="Write a template of a user-written law to "
                                            "-o FILE.py.")] = None,
    check: Annotated[list[Path] | None, typer.Option("--check", metavar="FILE", show_default=False, help="Run the "
                                                     "contract test of a user-written law; repeatable.")] = None,
    out: Annotated[Path | None, typer.Option("--output", "-o", help="Picture of the bench to write, .png or .svg; "
                                             "file of --new.")] = None,
    series: Annotated[bool, typer.Option("--series", help="With --json: also the signals of every test.")] = False,
    written: LawsOption = None, as_json: JsonOption = False, force: ForceOption = False, quiet: QuietOption = False,
) -> None:
    """Print the catalogue, a law, or the outcome of its bench."""
    from .. import laws as room
    from ..laws import catalogue, get

    if new is not None:
        from ..laws.contract.template import template

        write_template(new, out, kind="law", room=room, text=template, force=force, quiet=quiet)
        return
    if check:
        check_files(check, as_json, room=room, after="stictionid identify FILE --law {name} --laws {file}")
        return
    if test is not None:
        law, tests, values = _chosen(name, test)
        sizes, values = from_forces(law, values)
        S, J = sizes or (S, J)
        _bench(law, tests, values, S=S, J=J, out=out, series=series, as_json=as_json, force=force, quiet=quiet)
        return
    if out is not None:
        raise UsageError("-o writes the picture of a bench, and there is none without --test",
                         f"stictionid laws --test {name or 'chen'} -o {out}")
    if name is None:
        _list(list(catalogue().values()), as_json)
    else:
        _show(get(name), as_json)


def _chosen(name: str | None, test: str) -> tuple[Law, tuple[str, ...], dict[str, float]]:
    """The law, the tests and the law's own parameters that `[NAME] --test NAME` asks for."""
    from ..laws import get
    from ..model.valve_bench import TESTS

    if name is None:
        if test in TESTS:
            raise UsageError(f"'{test}' is a test, not a law", f"stictionid laws chen --test {test}")
        alone, values = parse_law(test)
        return get(alone), tuple(TESTS), values
    name, values = parse_law(name)
    law = get(name)
    if test in ("all", law.name):
        return law, tuple(TESTS), values
    if test not in TESTS:
        raise UsageError(f"unknown test '{test}'", "tests: all, " + ", ".join(TESTS))
    return law, (test,), values


def _table(*columns: str, rows: Iterable[Sequence[str]]) -> Any:
    """A table without frames: plain text on any output."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in columns:
        right = column.endswith("%")
        table.add_column(column, justify="right" if right else "left", overflow="fold", no_wrap=right)
    for row in rows:
        table.add_row(*row)
    return table


def _record(law: Law) -> dict[str, Any]:
    """A law as in the JSON."""
    return {
        "name": law.name, "summary": law.summary, "equation": law.equation, "source": law.source,
        "checked": law.checked, "cannot": law.cannot, "searchable": law.searchable,
        "one_parameter": law.one_parameter, "parameters": _parameters(law),
        **({"file": law.file, "sha256": law.sha256} if law.file else {}),
    }


def _parameters(law: Law) -> list[dict[str, Any]]:
    """S and J, or the one parameter, and the law's own."""
    sizes = {"S": "stickband plus deadband", "J": f"slip jump, J <= {'2 S' if law.searchable else 'S'}"}
    if law.one_parameter:
        sizes = {"S": "the band d = S = J; J is ignored"}
    rows = [{"name": name, "unit": "%", "low": 0.0, "high": None, "default": None, "meaning": meaning}
            for name, meaning in sizes.items()]
    return rows + [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "default": law.defaults[p.name],
                    "meaning": p.meaning} for p in law.parameters]


def _list(found: list[Law], as_json: bool) -> None:
    if as_json:
        print_json([_record(law) for law in found])
        return
    console = out_console()
    for law in found:
        console.print(_facts(law))
        console.print()
    console.print("stictionid laws NAME shows one in full, stictionid laws --test NAME puts it on the bench")


def _facts(law: Law) -> Any:
    """Name, parameters, equation, source and limits as rows of two columns."""
    own = ["S (J = S)"] if law.one_parameter else ["S", "J", *(p.name for p in law.parameters)]
    table = _table("", "", rows=(
        ("law", f"{law.name}: {law.summary}"), ("parameters", ", ".join(own)), ("equation", law.equation),
        ("source", f"{law.source}; {law.checked}"), ("cannot represent", law.cannot),
        ("used for", "identification and simulation" if law.searchable else "simulation only")))
    table.show_header = False
    return table


def _show(law: Law, as_json: bool) -> None:
    text = law.equation if law.file else (
        importlib.import_module(f"..laws.{law.name.replace('-', '_')}", __package__).__doc__ or "").strip()
    if as_json:
        print_json({**_record(law), "description": text})
        return
    console = out_console()
    console.print(_facts(law))
    console.print()
    console.print(_table("parameter", "unit", "range", "default", "meaning", rows=[
        (p["name"], p["unit"], f">= {p['low']:g}" if p["high"] is None else f"{p['low']:g} to {p['high']:g}",
         "-" if p["default"] is None else f"{p['default']:g}", p["meaning"]) for p in _parameters(law)]))
    console.print()
    console.print(_flowing(text))


def _flowing(text: str) -> str:
    """Paragraphs as single lines for the terminal to break; those with indented lines (equations) stay as they are."""
    parts = text.split("\n\n")
    return "\n\n".join(part if "\n " in part or part.startswith(" ") else part.replace("\n", " ") for part in parts)


def _bench(law: Law, tests: tuple[str, ...], values: dict[str, float], *, S: float, J: float, out: Path | None,
           series: bool, as_json: bool, force: bool, quiet: bool) -> None:
    from ..model.valve_bench import put_on_bench

    kind = out.suffix.lower() if out is not None else ""
    if out is not None:
        from ..reports.pictures.figures import PNG_KIND
        from ..reports.pictures.valve_bench import SVG_KIND, valve_figure

        kinds = {".png": PNG_KIND, ".svg": SVG_KIND}
        if kind not in kinds:
            raise UsageError(f"a picture can't be written as '{out.name}'", "end the name after -o in .png or .svg")
        ensure_writable(out, force=force, kind=kinds[kind])
    outcomes = put_on_bench(law, S=S, J=J, tests=tests, values=values)
    used_J = S if law.one_parameter else J
    newton = forces(law, S, used_J, values)
    if as_json:
        print_json({"law": law.name, "S": S, "J": used_J, "parameters": {**law.defaults, **values},
                    "forces_N": None if newton is None else {"F_s": newton[0], "F_c": newton[1]},
                    "tests": [o.to_dict(series=series) for o in outcomes],
                    "failed": [{"test": o.test, "what": e.what} for o in outcomes for e in o.expectations
                               if not e.holds]})
    else:
        _print_bench(law, S, used_J, newton, outcomes)
    if out is not None:
        title = f"{law.name}, S = {S:.4g} %, J = {used_J:.4g} %"
        write_whole(out, valve_figure(outcomes, kind=kind[1:], title=title), force=force, kind=kinds[kind])
        say(f"wrote {out}", quiet=quiet)


def _print_bench(law: Law, S: float, J: float, newton: tuple[float, float] | None,
                 outcomes: list[BenchOutcome]) -> None:
    console = out_console()
    console.print(f"{law.name}: S = {S:.4g} %, J = {J:.4g} %" + (" (one parameter, J = S)" if law.one_parameter else "")
                  + (f"; F_s = {newton[0]:.4g} N, F_c = {newton[1]:.4g} N" if newton else ""))
    console.print()
    console.print(_table("test", "dead band %", "resolution %", "overshoot %", rows=[
        (o.test, _number(o.dead_band), _number(o.resolution), _number(o.overshoot)) for o in outcomes]))
    console.print("dead band and resolution in % of command, overshoot in % of J; - where a test shows none")
    console.print()
    console.print(_table("test", "expectation", "found", "ideal", "", rows=[
        (o.test, e.what, _number(e.measured) + ("" if e.unit == "%" or e.measured is None else f" {e.unit}"),
         _number(e.expected), "holds" if e.holds else "FAILS") for o in outcomes for e in o.expectations]))
    failed = sum(not e.holds for o in outcomes for e in o.expectations)
    total = sum(len(o.expectations) for o in outcomes)
    console.print()
    console.print(f"{total - failed} of {total} expectations hold" + (f"; {law.name} cannot represent: {law.cannot}"
                                                                     if failed else ""))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
