"""S and J from records in which PV is missing in a pattern of rows, against the same record without missing cells.

Run: python benchmarks/missing_cells.py [--loops first-order,…] [--patterns every-2nd,…] [--word Bad] [--seed 0]
Every record is simulated, written as CSV with empty PV cells (or a word in them) and read like any export; OP and SP
stay complete. A line holds S and J in %, their difference to the intact record's in % of the intact one's, and the
reason where the tool abstains. The last lines count the answers inside the intact record's interval, the number that
honest intervals let expect there, the intervals that overlap, and those that hold the truth. A record with a tenth of
its PV knows S ten times less finely. Exit 1 where a traceback, an S more than 2 % or a J more than 10 % away is found.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from stictionid.historian import read_loop
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Loop
from stictionid.record.study import Study
from stictionid.typing import BoolArray
from stictionid.verbs.identify import Options, identify

# Differences to the intact record that pass, as shares of its S and J.
MOST_S, MOST_J = 0.02, 0.10
# Half width of a 90 % interval of a normal error in standard deviations.
_NORMAL = 1.645

_MOVES = tuple((150.0 * k, (-1) ** k * 4.0) for k in range(10))
LOOPS = {
    "first-order": Setting(Plant(2.0, 12.0, 6.0), Controller(0.35, 12.0, scan_s=1.0), S=4.0, J=2.0, duration_s=1500.0,
                           noise_sd=0.05, setpoint_moves=_MOVES),
    "integrating": Setting(Plant(1.0, 0.3, 1.0, integrating=True), Controller(0.1, 5.0), S=5.0, J=3.5,
                           duration_s=1500.0, noise_sd=0.05),
    "second-order": Setting(Plant(1.5, 15.0, 5.0, second_time_constant_s=6.0), Controller(0.5, 12.0, scan_s=1.0),
                            S=5.0, J=3.0, duration_s=2000.0, noise_sd=0.05),
    "first-slow": Setting(Plant(1.2, 25.0, 10.0), Controller(0.9, 25.0, scan_s=1.0), S=2.5, J=1.5, duration_s=2000.0,
                          noise_sd=0.04, setpoint_moves=((0.0, 3.0),)),
    "first-smooth": Setting(Plant(0.8, 15.0, 5.0), Controller(1.2, 15.0), S=3.0, J=0.6, duration_s=1500.0,
                            noise_sd=0.03, setpoint_moves=_MOVES),
    "second-moves": Setting(Plant(2.5, 20.0, 6.0, second_time_constant_s=5.0), Controller(0.3, 20.0, scan_s=1.0),
                            S=3.0, J=2.0, duration_s=1500.0, noise_sd=0.08, setpoint_moves=_MOVES),
    "with-sine": Setting(Plant(2.0, 12.0, 6.0), Controller(0.35, 12.0, scan_s=1.0), S=4.0, J=2.0, duration_s=1500.0,
                         noise_sd=0.05, setpoint_moves=_MOVES, effects=(
                             ("sinusoidal-disturbance", {"period_s": 70.0, "amplitude": 0.8, "phase": 1.0}),)),
    "with-ramp": Setting(Plant(1.5, 18.0, 6.0), Controller(0.6, 18.0, scan_s=1.0), S=4.0, J=2.5, duration_s=1500.0,
                         noise_sd=0.05, setpoint_moves=((0.0, 3.0),), effects=(
                             ("ramp-disturbance", {"start_s": 500.0, "rate": 0.01}),)),
    "with-filter": Setting(Plant(2.0, 14.0, 5.0), Controller(0.4, 14.0, scan_s=1.0), S=5.0, J=3.0, duration_s=1500.0,
                           noise_sd=0.05, setpoint_moves=_MOVES, effects=(
                               ("measurement-filter", {"time_constant_s": 3.0}),)),
    "with-colour": Setting(Plant(2.0, 12.0, 6.0), Controller(0.35, 12.0, scan_s=1.0), S=4.0, J=2.5, duration_s=1500.0,
                           setpoint_moves=_MOVES, effects=(("coloured-noise", {"root": 0.8, "innovation_sd": 0.04}),)),
}
"""Name to the simulated loop: processes of first and second order and an integrator, with setpoint moves and in limit
cycles, scanned and continuous, and four with an effect that the base lacks."""


def patterns(n: int, seed: int = 0) -> dict[str, BoolArray]:
    """Name to the rows (n,) whose PV is missing."""
    k, rng = np.arange(n), np.random.default_rng(seed)
    return {
        "every-2nd": k % 2 == 1,
        "every-3rd": k % 3 == 2,
        "two-of-3": k % 3 != 0,
        "4-of-5": k % 5 != 0,
        "9-of-10": k % 10 != 0,
        "19-of-20": k % 20 != 0,
        "10th-kept": k % 10 != 7,
        "random-10%": rng.random(n) < 0.1,
        "random-half": rng.random(n) < 0.5,
        "blocks": k % 200 >= 170,
        "first-fifth": k < n // 5,
        "last-fifth": k >= n - n // 5,
    }


def write(loop: Loop, missing: BoolArray, path: Path, word: str = "") -> Path:
    """The record as CSV with `word` in the PV cells that are missing."""
    assert loop.setpoint is not None
    rows = zip(loop.time_s.tolist(), loop.setpoint.tolist(), loop.process_value.tolist(), loop.output.tolist(),
               missing.tolist(), strict=True)
    lines = [f"{t!r},{r!r},{word if gone else repr(y)},{u!r}" for t, r, y, u, gone in rows]
    path.write_text("\n".join(["time_s,SP,PV,OP", *lines]) + "\n")
    return path


@dataclass(frozen=True, slots=True)
class Told:
    """The study of one record, or None where it ended in a traceback, which `reason` then names."""

    study: Study | None
    reason: str
    seconds: float

    def against(self, intact: Told) -> tuple[float, float] | None:
        """Shares by which S and J differ from the intact record's; None where one of them has no estimate."""
        if self.study is None or self.study.estimate is None or intact.study is None or intact.study.estimate is None:
            return None
        mine, other = self.study.estimate, intact.study.estimate
        return mine.S / other.S - 1.0, mine.J / other.J - 1.0

    def within(self, intact: Told, setting: Setting) -> tuple[list[float], ...] | None:
        """For S and J: inside the intact record's interval, expected there, overlap, own interval holds the truth.

        The two differ by what the intact record knows more: a normal error whose variance is the difference of theirs.
        None without both estimates.
        """
        if self.study is None or self.study.estimate is None or intact.study is None or intact.study.estimate is None:
            return None
        mine, other = self.study.estimate, intact.study.estimate
        found = []
        for value, own, whole, truth in ((mine.S, mine.S_interval, other.S_interval, setting.S),
                                         (mine.J, mine.J_interval, other.J_interval, setting.J)):
            if own is None or whole is None:
                return None
            half = [0.5 * (high - low) for low, high in (own, whole)]
            sd = math.sqrt(max(half[0]**2 - half[1]**2, 0.0)) / _NORMAL
            found.append((whole[0] <= value <= whole[1], math.erf(half[1] / (sd * math.sqrt(2.0))) if sd else 1.0,
                          own[0] <= whole[1] and whole[0] <= own[1], own[0] <= truth <= own[1]))
        return tuple([float(S), float(J)] for S, J in zip(*found, strict=True))

    def passes(self, intact: Told) -> bool:
        """True where the answer is that of the intact record, or an abstention with a reason."""
        gone = self.against(intact)
        if gone is None:
            return self.study is not None
        return abs(gone[0]) <= MOST_S and abs(gone[1]) <= MOST_J


def told(path: Path, options: Options | None = None) -> Told:
    """Answer of `identify` to one file."""
    begun = time.perf_counter()
    try:
        study = identify(read_loop(path), options=options)
    except Exception as error:  # a traceback is what this benchmark is for
        return Told(None, f"TRACEBACK {type(error).__name__}: {error}", time.perf_counter() - begun)
    return Told(study, "" if study.estimate else study.verdict.reason, time.perf_counter() - begun)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", default=",".join(LOOPS))
    parser.add_argument("--patterns", default=",".join(patterns(20)))
    parser.add_argument("--word", default="")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    failed, abstained, counted = 0, 0, []
    print(f"{'loop':13}{'missing PV':14}{'S %':>8}{'J %':>8}{'dS %':>8}{'dJ %':>8}{'verdict':>14}{'s':>6}  why")
    for name in args.loops.split(","):
        loop = simulate(LOOPS[name], seed=args.seed).loop
        masks = {"none": np.zeros(loop.samples, bool)} | patterns(loop.samples, args.seed)
        with tempfile.TemporaryDirectory() as folder:
            intact = None
            for pattern in ("none", *args.patterns.split(",")):
                found = told(write(loop, masks[pattern], Path(folder) / f"{pattern}.csv", args.word))
                intact = intact or found
                failed += not found.passes(intact)
                if pattern != "none":
                    abstained += bool(found.reason) and found.study is not None
                    counted += [both] if (both := found.within(intact, LOOPS[name])) else []
                gone, estimate = found.against(intact), found.study.estimate if found.study else None
                numbers = f"{estimate.S:8.3f}{estimate.J:8.3f}" if estimate else " " * 16
                numbers += f"{100 * gone[0]:8.2f}{100 * gone[1]:8.2f}" if gone else " " * 16
                verdict = found.study.verdict.stiction if found.study else "-"
                mark = "" if found.passes(intact) else "FAILED " if not found.reason else ""
                print(f"{name:13}{pattern:14}{numbers}{verdict:>14}{found.seconds:6.1f}  {mark}{found.reason}",
                      flush=True)
    for k, words in enumerate(("inside the intact interval", "expected there of honest intervals",
                               "intervals that overlap", "intervals that hold the truth")):
        S, J = (sum(both[k][j] for both in counted) for j in (0, 1))
        print(f"{words}: S {S:.0f}, J {J:.0f} of {len(counted)} with intervals")
    print(f"{abstained} abstained, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
