"""Fault injection: numbers that break arithmetic end in a refusal or a verdict with the reason, without warnings.

The library gets every case in a process of its own, once as arrays and once as a file. Each warning is an error there.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable

import numpy as np
from fault_bench import LIMIT_S, Bench, Result, surroundings

ROWS = 1000
Pair = tuple[np.ndarray, np.ndarray]
# What may come of a case: a refusal, an abstention, anything that is not "stiction", anything at all that holds.
REFUSED, ABSTAINED, DOUBTED, ANY = "refused", "abstained", "doubted", "any"


def _with(values: np.ndarray, at: slice | int, what: float) -> np.ndarray:
    values = values.copy()
    values[at] = what
    return values


def _levels(values: np.ndarray) -> np.ndarray:
    return np.where(values > 50, 60.0, 40.0)


# Case: the (output, process value) made of a good loop's, and what may come of it as arrays.
CASES: dict[str, tuple[Callable[[np.ndarray, np.ndarray, np.random.Generator], Pair], str]] = {
    "NaN in PV": (lambda u, y, g: (u, _with(y, slice(50, 60), np.nan)), REFUSED),
    "NaN in OP": (lambda u, y, g: (_with(u, 7, np.nan), y), REFUSED),
    "infinite PV": (lambda u, y, g: (u, _with(y, 100, np.inf)), REFUSED),
    "nothing but NaN": (lambda u, y, g: (u, y * np.nan), REFUSED),
    "denormal PV": (lambda u, y, g: (u, (y - 50) * 5e-314), ABSTAINED),
    "PV of 1e300": (lambda u, y, g: (u, y * 1e300), REFUSED),
    "PV of 1e-300": (lambda u, y, g: (u, y * 1e-300), ABSTAINED),
    "PV of 1e30": (lambda u, y, g: (u, y * 1e30), ANY),
    "PV of 1e-30": (lambda u, y, g: (u, y * 1e-27), ANY),
    "one PV of 1e300": (lambda u, y, g: (u, _with(y, 7, 1e300)), REFUSED),
    "one PV of 1e37": (lambda u, y, g: (u, _with(y, 7, 1e37)), DOUBTED),
    "OP of 1e300": (lambda u, y, g: (u * 1e300, y), REFUSED),
    "OP of 1e30": (lambda u, y, g: (u * 1e30, y), ANY),
    "OP of 1e-300": (lambda u, y, g: (u * 1e-300, y), ABSTAINED),
    "constant OP": (lambda u, y, g: (u * 0 + 50, y), ABSTAINED),
    "constant PV": (lambda u, y, g: (u, y * 0 + 3), ABSTAINED),
    "both zero": (lambda u, y, g: (u * 0, y * 0), ABSTAINED),
    "PV exactly zero now and then": (lambda u, y, g: (u, np.where(np.arange(ROWS) % 40 < 20, 0.0, y)), DOUBTED),
    "OP of two levels": (lambda u, y, g: (_levels(u), y), DOUBTED),
    "PV of two levels": (lambda u, y, g: (u, _levels(y)), DOUBTED),
    "PV is OP": (lambda u, y, g: (u, u.copy()), ABSTAINED),
    "PV is minus OP": (lambda u, y, g: (u, 100 - u), ABSTAINED),
    "PV is OP in another unit": (lambda u, y, g: (u, 32 + 1.8 * u), ABSTAINED),
    "PV is noise": (lambda u, y, g: (u, g.standard_normal(ROWS)), DOUBTED),
    "PV is a random walk": (lambda u, y, g: (u, np.cumsum(g.standard_normal(ROWS))), DOUBTED),
    "PV is a ramp": (lambda u, y, g: (u, np.arange(ROWS) * 1.0), DOUBTED),
    "PV is one impulse": (lambda u, y, g: (u, _with(y * 0, ROWS // 2, 1.0)), DOUBTED),
    "PV is another loop": (lambda u, y, g: (u, y[::-1].copy()), DOUBTED),
    "OP is noise": (lambda u, y, g: (50 + g.standard_normal(ROWS), y), DOUBTED),
    "offset of 1e12": (lambda u, y, g: (u, y + 1e12), ANY),
    "whole numbers": (lambda u, y, g: (np.round(u), np.round(y)), ANY),
}


def good_loop() -> Pair:
    """Output and process value (ROWS,) of a sticking loop that reads well."""
    from dataclasses import replace

    from stictionid.model.closed_loop import preset, simulate

    loop = simulate(replace(preset("foptd"), S=4.0, J=2.0, noise_sd=0.02, duration_s=float(ROWS)), seed=3).loop
    return np.array(loop.output), np.array(loop.process_value)


def outcome_of(u: np.ndarray, y: np.ndarray, *, as_file: bool) -> str:
    """"refused", "abstained", or the verdict; AssertionError for a study that does not hold together."""
    from stictionid.errors import DataError
    from stictionid.historian import read_loop
    from stictionid.record.loop import Loop
    from stictionid.record.study import study_from_json, to_json
    from stictionid.verbs.identify import identify

    try:
        if as_file:
            rows = "\n".join(f"{k},{float(a)!r},{float(b)!r}" for k, (a, b) in enumerate(zip(u, y, strict=True)))
            loop = read_loop(io.BytesIO(f"t,OP,PV\n{rows}\n".encode()))
        else:
            loop = Loop(output=u, process_value=y, step_s=1.0, name="odd")
        study = identify(loop)
    except DataError:
        return REFUSED
    json.loads(to_json(study), parse_constant=_no_constant)
    assert study_from_json(to_json(study)).verdict == study.verdict
    assert study.verdict.reason
    return ABSTAINED if study.estimate is None else study.verdict.stiction


def _no_constant(text: str) -> None:
    raise AssertionError(f"{text} in a study")


def fits(outcome: str, may: str) -> bool:
    """Whether what came of a case may come of it."""
    if outcome in (REFUSED, ABSTAINED):
        return may in (outcome, DOUBTED, ANY)
    return may == ANY or (may == DOUBTED and outcome != "stiction")


def try_all() -> list[str]:
    """What goes wrong in this process, in sentences."""
    import warnings

    u, y = good_loop()
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, (make, may) in CASES.items():
            for as_file in (False, True):
                output, value = make(u, y, np.random.default_rng(0))
                try:
                    outcome = outcome_of(output, value, as_file=as_file)
                except Exception as error:
                    found.append(f"{name}, as {'a file' if as_file else 'arrays'}: {type(error).__name__}: {error}")
                    continue
                # The reader leaves out or blanks what arrays are refused for, and then the rest of the record counts.
                if not fits(outcome, ANY if as_file and may == REFUSED else may):
                    found.append(f"{name}, as {'a file' if as_file else 'arrays'}: {outcome}, not {may}")
    return found


def numbers(bench: Bench) -> Result:
    """NaN, infinities, denormals, 1e±300, constant and two-level signals, collinear ones, PV unrelated to OP."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, cwd=bench.folder,
                          timeout=5 * LIMIT_S, env=surroundings(None))
    found = done.stdout.splitlines()
    if done.returncode or done.stderr.strip():
        found.append(f"exit {done.returncode}, stderr: {done.stderr.strip()[-300:]}")
    return 2 * len(CASES), found, ""


FAULTS = {"numbers that break arithmetic": numbers}

if __name__ == "__main__":
    for problem in try_all():
        print(problem)
