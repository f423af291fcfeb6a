"""`stictionid simulate`: a loop with a sticky valve, and the truth behind it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import UsageError
from ..system.files import ensure_writable, write_whole
from ..system.plurals import counted
from .app import app, outcome
from .common.completion import effect_names, law_names
from .common.law_option import from_forces, parse_law
from .common.options import EffectsOption, ForceOption, JsonOption, LawsOption, QuietOption, SeedOption
from .common.output import print_json, say


@app.command(epilog=outcome("the data file, and its name with .truth.json unless --no-truth",
                            json="file, truth_file, rows, truth"))
def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", help="Data file: .csv, .tsv, .txt or .parquet.")],
    preset: Annotated[str, typer.Option(help="Loop to start from: foptd, itptd (Shang et al., Table 1) or tank.")]
    = "foptd",
    law: Annotated[str, typer.Option(metavar="NAME[:par=value,…]", autocompletion=law_names,
                                     help="Stiction law of the valve, see stictionid laws; numbers of its own after a "
                                     "colon, karnopp:mass=2.")] = "chen",
    S: Annotated[float | None, typer.Option("--S", help="Stickband plus deadband, % of travel.")] = None,
    J: Annotated[float | None, typer.Option("--J", help="Slip jump, % of travel.")] = None,
    effect: Annotated[list[str] | None, typer.Option(
        autocompletion=effect_names,
        help="NAME:par=value,… hides a physical effect; repeatable. NAME alone takes numbers that show, and prints "
             "them.")]
    = None,
    setpoint: Annotated[list[str] | None, typer.Option(
        help="TIME:SIZE, a setpoint step in seconds and units of r; repeatable; replaces the preset's.")] = None,
    scan: Annotated[float | None, typer.Option(help="Controller scan in seconds, output held; 0 is continuous.")]
    = None,
    noise: Annotated[float | None, typer.Option(help="Standard deviation of the measurement noise, units of y.")]
    = None,
    scatter: Annotated[float | None, typer.Option(
        help="Standard deviation of the break-away force from stroke to stroke, % of travel.")] = None,
    duration: Annotated[float | None, typer.Option(help="Length in seconds.")] = None,
    step: Annotated[float | None, typer.Option(help="Sampling time of the file in seconds.")] = None,
    quantise: Annotated[float | None, typer.Option(help="Resolution of the PV measurement, units of y.")] = None,
    gain: Annotated[float | None, typer.Option(help="Process gain, units of y per % (per second if integrating).")]
    = None,
    time_constant: Annotated[float | None, typer.Option(help="Process lag in seconds.")] = None,
    second_time_constant: Annotated[float | None, typer.Option(help="Second process lag in seconds.")] = None,
    dead_time: Annotated[float | None, typer.Option(help="Process dead time in seconds.")] = None,
    integrating: Annotated[bool | None, typer.Option("--integrating/--self-regulating")] = None,
    kc: Annotated[float | None, typer.Option("--kc", help="Controller gain, % per unit of y.")] = None,
    ti: Annotated[float | None, typer.Option("--ti", help="Controller integral time in seconds.")] = None,
    td: Annotated[float | None, typer.Option("--td", help="Controller derivative time in seconds.")] = None,
    seed: SeedOption = 0,
    truth: Annotated[bool, typer.Option("--truth/--no-truth", help="Write NAME.truth.json beside the data.")] = True,
    effects: EffectsOption = None, laws: LawsOption = None,
    force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Simulate a control loop with a sticky valve, and write the record with its truth.

    Starts at rest with r = u = y = 50 %. Same seed, same bytes.

    Example: stictionid simulate --S 5 --J 3 --noise 0.05 -o loop.csv
    """
    from ..laws import get as get_law
    from ..model.closed_loop import preset as find_preset
    from ..model.closed_loop import simulate as run
    from ..record.study import to_json
    from ..record.write import check_kind, write_loop

    truth_file = output.with_suffix(".truth.json")
    ensure_writable(output, force=force, kind=check_kind(output))
    if truth:
        ensure_writable(truth_file, force=force, kind=b"{")
    base = find_preset(preset)
    name, values = parse_law(law)
    sizes, values = from_forces(get_law(name), values)
    S, J = sizes or (S, J)
    setting = replace(
        base, law=name, law_values=tuple(values.items()),
        setpoint_moves=tuple(_move(text) for text in setpoint) if setpoint else base.setpoint_moves,
        plant=replace(base.plant, **_given(gain=gain, time_constant_s=time_constant, dead_time_s=dead_time,
                                           second_time_constant_s=second_time_constant, integrating=integrating)),
        controller=replace(base.controller, **_given(gain=kc, integral_time_s=ti, derivative_time_s=td, scan_s=scan)),
        **_given(S=S, J=J, noise_sd=noise, scatter=scatter, duration_s=duration, step_s=step, quantise=quantise),
    )
    setting = replace(setting, effects=tuple(_sized(*_effect(text), setting, seed, quiet) for text in effect or ()))
    result = run(setting, seed=seed)
    write_loop(result.loop, output, force=force)
    if truth:
        write_whole(truth_file, to_json(result.truth), force=force, kind=b"{")
    if as_json:
        print_json({"file": str(output), "truth_file": str(truth_file) if truth else None,
                    "rows": result.loop.samples, "truth": result.truth})
    else:
        say(f"wrote {output}: {counted(result.loop.samples, 'sample')} of {result.loop.step_s:g} s"
            + (f"; truth in {truth_file}" if truth else ""), quiet=quiet)
        say(f"next: stictionid identify {output}", quiet=quiet)


def _sized(name: str, values: dict[str, float | str], setting: Any, seed: int,
           quiet: bool) -> tuple[str, dict[str, float | str]]:
    """An effect with its numbers; one without any takes numbers that show in this loop, which are printed."""
    if any(key != "at" for key in values):
        return name, values
    from ..model.visible import visible_values

    chosen: dict[str, float | str] = {**visible_values(name, setting, seed=seed), **values}
    said = ",".join(f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
                    for key, value in chosen.items())
    say(f"effect with numbers that show: --effect {name}:{said}", quiet=quiet)
    return name, chosen


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _move(text: str) -> tuple[float, float]:
    at, colon, size = text.partition(":")
    try:
        if colon:
            return float(at), float(size)
    except ValueError:
        pass
    raise UsageError(f"--setpoint '{text}' is not TIME:SIZE", "write for example --setpoint 300:5")


def _effect(text: str) -> tuple[str, dict[str, float | str]]:
    name, _, rest = text.partition(":")
    values: dict[str, float | str] = {}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not equals:
            raise UsageError(f"--effect '{text}': '{part}' is not par=value",
                             f"write --effect {name}:NAME=NUMBER; stictionid effects {name} lists the parameters")
        try:
            values[key.strip()] = float(value)
        except ValueError:
            values[key.strip()] = value.strip()
    return name.strip(), values
