"""S from exports that are slower than the controller's 1 s scan: one row in 2, 5 and 10, and averages over 10 and 60 s.

Run: python benchmarks/slow_exports.py [--loops first-order,…] [--exports every-5th,…] [--seed 0] [--digits 4]
Every record is simulated with a 1 s scan, rounded as a historian rounds, thinned or averaged, written as CSV and read
like any export. A line holds S and its interval in %, the error of S, verdict and the findings that say how far the
samples are to be trusted. An answer is honest where S is within 5 %, its interval holds the truth, no interval is given
and a finding says why, or the tool abstains. Averages with an answer must be recognised. Exit 1 where one is not.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from missing_cells import LOOPS as SHORT

from stictionid.historian import read_loop
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.typing import FloatArray
from stictionid.verbs.identify import identify

CLOSE = 0.05
"""Share of S up to which an answer needs no interval."""
FEWEST_ROWS = 240
"""Rows of an export, at least: slow exports come from longer records."""
_SCANNED = {"integrating": Controller(0.1, 5.0, scan_s=1.0), "first-smooth": Controller(1.2, 15.0, scan_s=1.0)}
LOOPS = {name: replace(s, controller=_SCANNED.get(name, s.controller)) for name, s in SHORT.items() if not s.effects}
LOOPS["tank"] = Setting(Plant(2.286, 180.0, 36.67), Controller(1.5, 180.0, scan_s=1.0), S=1.7, J=1.2, noise_sd=0.01,
                        duration_s=6000.0, setpoint_moves=((0.0, 1.0),))
"""Name to the simulated loop, all with a 1 s scan: those of missing_cells.py without a missing effect, and a slow one.
"""
EXPORTS = {"every-scan": (1, False), "every-2nd": (2, False), "every-5th": (5, False), "every-10th": (10, False),
           "mean-10": (10, True), "mean-60": (60, True)}
"""Name to the number of scans in a row of the export, and whether the row is their mean."""
_TRUSTED = ("averaged", "scans-too-noisy", "scans-unseen", "scans-between-samples")


def recorded(name: str, scans: int, seed: int, digits: int) -> Loop:
    """The loop's record at every scan, long enough for the export, with values of so many decimals."""
    setting = LOOPS[name]
    length = max(setting.duration_s, float(FEWEST_ROWS * scans))
    moves = setting.setpoint_moves
    if len(moves) > 1:
        moves = tuple((150.0 * k + 3.0, (-1) ** k * 4.0) for k in range(int(length / 150.0)))
    loop = simulate(replace(setting, duration_s=length, setpoint_moves=moves), seed=seed).loop
    assert loop.setpoint is not None
    y, u, r = (np.round(x, digits) for x in (loop.process_value, loop.output, loop.setpoint))
    return replace(loop, process_value=y, output=u, setpoint=r, position=None)


def exported(values: FloatArray, scans: int, mean: bool) -> FloatArray:
    """The rows of an export: every so manieth value, or the mean of as many."""
    whole = values[:values.size // scans * scans].reshape(-1, scans)
    return whole.mean(axis=1) if mean else whole[:, 0]


def write(loop: Loop, scans: int, mean: bool, path: Path) -> Path:
    """The export as CSV."""
    assert loop.setpoint is not None
    rows = zip(*(exported(x, scans, mean).tolist() for x in (loop.setpoint, loop.process_value, loop.output)),
               strict=True)
    lines = [f"{k * scans},{r!r},{y!r},{u!r}" for k, (r, y, u) in enumerate(rows)]
    path.write_text("\n".join(["time_s,SP,PV,OP", *lines]) + "\n")
    return path


def honest(study: Study, S: float, mean: bool) -> bool:
    """True where the answer is close, or its interval holds the truth, or it is withheld with a reason."""
    codes = {f.code for f in (*study.data.findings, *(f for s in study.steps for f in s.findings))}
    e = study.estimate
    if mean and e is not None and "averaged" not in codes:
        return False
    if e is None or abs(e.S / S - 1.0) <= CLOSE:
        return True
    if e.S_interval is None:
        return bool(codes & set(_TRUSTED))
    return e.S_interval[0] <= S <= e.S_interval[1]


def main() -> int:
    """Print the table; the exit code says whether an answer was not honest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", default=",".join(LOOPS))
    parser.add_argument("--exports", default=",".join(EXPORTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--digits", type=int, default=4, help="decimals of the recorded values")
    args = parser.parse_args()
    asked = close = held = failed = 0
    print(f"{'loop':13}{'export':12}{'S true':>7}{'S':>7}{'interval':>16}{'error %':>9}{'J err %':>9}{'verdict':>13}"
          f"{'s':>6}  said")
    for name in args.loops.split(","):
        for export in args.exports.split(","):
            scans, mean = EXPORTS[export]
            S, J = LOOPS[name].S, LOOPS[name].J
            with tempfile.TemporaryDirectory() as folder:
                path = write(recorded(name, scans, args.seed, args.digits), scans, mean, Path(folder) / "export.csv")
                begun = time.perf_counter()
                study = identify(read_loop(path))
            e, good = study.estimate, honest(study, S, mean)
            asked, failed = asked + 1, failed + (not good)
            codes = dict.fromkeys(f.code for f in (*study.data.findings, *(f for s in study.steps for f in s.findings))
                                  if f.code in _TRUSTED)
            said = ", ".join([*codes, *(s.added for s in study.steps if s.added)])
            if e is None:
                numbers, said = " " * 39, f"{said}: {study.verdict.reason[:90]}"
            else:
                close += abs(e.S / S - 1.0) <= CLOSE
                span = e.S_interval
                held += span is not None and span[0] <= S <= span[1]
                words = "withheld" if span is None else f"{span[0]:.2f} to {span[1]:.2f}"
                numbers = f"{e.S:7.2f}{words:>16}{100 * (e.S / S - 1):9.1f}{100 * (e.J / J - 1):9.1f}"
            print(f"{name:13}{export:12}{S:7.2f}{numbers}{study.verdict.stiction:>13}"
                  f"{time.perf_counter() - begun:6.1f}  {'' if good else 'FAILED '}{said}", flush=True)
    print(f"{asked} exports: S within {100 * CLOSE:.0f} % in {close}, interval holds it in {held}, not honest {failed}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
