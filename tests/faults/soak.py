"""Soak test: thousands of loops identified in one process, with a check of its memory and its open files.

Run: python tests/faults/soak.py [--identifications 10000] [--minutes 40] [--seed 0] [--record [FILE]]

Records are small and different: sticking and healthy loops, and signals that only allow abstention. Every path from
reading to the study's text is therefore run many times. After a start-up the memory in use must stay within 5 % and no
handle may be left open. Exit 1 otherwise.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import hard_results

ROWS = 120
# Distinct records are made of this many simulated loops; noise makes each its own.
_LOOPS = 24
# Share of the loops of which enough cycles are in the record for an estimate; the others end at a gate.
_WHOLE = 0.1
GROWTH = 0.05
# The first part of a run fills caches: memory is compared with what it was after it.
_STARTUP_SHARE = 0.1


@dataclass
class Soaked:
    """What a soak came to: counts by outcome, memory in MB and open handles along the way."""

    outcomes: Counter[str] = field(default_factory=Counter)
    memory_mb: list[float] = field(default_factory=list)
    handles: list[int] = field(default_factory=list)

    @property
    def growth(self) -> float:
        """Memory at the end over memory after the start-up, minus 1; medians, because the kernel is lazy."""
        part = max(len(self.memory_mb) // 10, 1)
        first = int(_STARTUP_SHARE * len(self.memory_mb))
        after, end = np.median(self.memory_mb[first:first + part]), np.median(self.memory_mb[-part:])
        return float(end / after - 1.0)

    @property
    def problems(self) -> list[str]:
        """What a leak looks like, in sentences."""
        found = [f"memory grew by {100 * self.growth:.1f} %"] * (self.growth > GROWTH)
        first = int(_STARTUP_SHARE * len(self.handles))
        if self.handles and self.handles[-1] > self.handles[first]:
            found.append(f"open handles grew from {self.handles[first]} to {self.handles[-1]}")
        return found + [f"{name}: {count} times" for name, count in self.outcomes.items() if name.startswith("defect")]


def memory_mb() -> float:
    """Memory of this process that is really held, in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def handles() -> int:
    """Files, pipes and sockets this process holds open."""
    return len(os.listdir("/proc/self/fd"))


def templates() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Setpoint, output and process value of a few loops, one in `1/_WHOLE` long enough for an estimate."""
    from stictionid.model.closed_loop import preset, simulate

    made = []
    rng = np.random.default_rng(1)
    for i in range(_LOOPS):
        whole = i < _WHOLE * _LOOPS
        rows = 5 * ROWS if whole else ROWS
        S = float(rng.uniform(2.0, 8.0)) * (i % 3 != 2)
        moves = ((0.0, 5.0),) if S or not whole else tuple((k * rows / 8, 5.0 - 9.0 * (k % 2)) for k in range(8))
        loop = simulate(replace(preset("foptd"), S=S, J=0.6 * S, duration_s=float(rows), setpoint_moves=moves)).loop
        assert loop.setpoint is not None
        made.append((np.array(loop.setpoint), np.array(loop.output), np.array(loop.process_value)))
    return made


def soak(identifications: int, minutes: float, seed: int, *, tell: bool = False) -> Soaked:
    """Identify until the number or the time is reached; every record is written, read, identified and made JSON."""
    from stictionid.errors import StictionidError
    from stictionid.historian import read_loop
    from stictionid.record.study import study_from_json, to_json
    from stictionid.verbs.identify import identify

    loops, rng, soaked = templates(), np.random.default_rng(seed), Soaked()
    end = time.monotonic() + 60 * minutes
    every = max(identifications // 200, 1)
    for k in range(identifications):
        r, u, y = loops[k % len(loops)]
        y = y + 0.02 * rng.standard_normal(y.size)
        text = "t,SP,PV,OP\n" + "\n".join(f"{i},{a:.4f},{b:.4f},{c:.4f}" for i, (a, b, c) in
                                          enumerate(zip(r, y, u, strict=True)))
        try:
            study = identify(read_loop(io.BytesIO(text.encode())))
            study = study_from_json(to_json(study))
            outcome = "estimated" if study.estimate is not None else "abstained"
        except StictionidError as error:
            outcome = f"refused: {type(error).__name__}"
        except Exception as error:
            outcome = f"defect: {type(error).__name__}: {error}"[:120]
        soaked.outcomes[outcome] += 1
        if k % every == every - 1:
            soaked.memory_mb.append(memory_mb())
            soaked.handles.append(handles())
            if tell and k % (10 * every) == 10 * every - 1:
                print(f"{k + 1} identified, {soaked.memory_mb[-1]:.0f} MB, {soaked.handles[-1]} handles", flush=True)
            if time.monotonic() > end:
                break
    return soaked


def main() -> int:
    """Soak, print, record."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--identifications", type=int, default=10_000)
    arguments.add_argument("--minutes", type=float, default=40.0)
    arguments.add_argument("--seed", type=int, default=0)
    hard_results.add_record_option(arguments)
    chosen = arguments.parse_args()
    fingerprint, begun = hard_results.code(), time.monotonic()
    soaked = soak(chosen.identifications, chosen.minutes, chosen.seed, tell=True)
    first = int(_STARTUP_SHARE * len(soaked.memory_mb))
    done = sum(soaked.outcomes.values())
    print(f"soak: {done} identifications {dict(soaked.outcomes)}, memory {soaked.memory_mb[first]:.0f} MB after the "
          f"start-up, {soaked.memory_mb[-1]:.0f} MB at the end ({100 * soaked.growth:+.1f} %), "
          f"{soaked.handles[-1]} handles")
    for problem in soaked.problems:
        print(f"    {problem}")
    if chosen.record:
        hard_results.add("soak", fingerprint, {
            "seed": chosen.seed, "seconds": round(time.monotonic() - begun), "identifications": done,
            "outcomes": dict(soaked.outcomes), "memory_mb": [round(soaked.memory_mb[first]),
                                                             round(soaked.memory_mb[-1])],
            "growth": round(soaked.growth, 4), "handles": [soaked.handles[first], soaked.handles[-1]],
            "problems": soaked.problems}, chosen.record)
    return int(bool(soaked.problems))


if __name__ == "__main__":
    sys.exit(main())
