"""The path of a valve: when it slips, how its break-away force scatters, and how its command errs.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np

from ..typing import FloatArray, IntArray

# Least variance of a break-away force alone, as a share of the scatter's square.
_LEAST_OWN = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Slips:
    """The events of one path: samples of the command's grid (m,) in order, and kinds (m,); the grid has `size` samples.

    A kind is a slip up (1) or down (-1), or that a sliding stem stops, or slides on, against what the recorded command
    says (2): the command is known to an error. From sample `known` on the law decides: nothing measured depends on it.
    """

    at: IntArray
    kind: IntArray
    known: int
    size: int

    @property
    def count(self) -> int:
        """Number of slips."""
        return int((np.abs(self.kind) == 1).sum())

    def _key(self) -> tuple[bytes, bytes, int, int]:
        return self.at.tobytes(), self.kind.tobytes(), self.known, self.size

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Slips) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        return f"Slips({sha256(repr(self._key()).encode()).hexdigest()[:16]})"


@dataclass(frozen=True, slots=True)
class Landing:
    """Error with which a stem lands, times the gain and over the noise, and the named values that it was told at."""

    ratio: float
    values: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class ScanErrors:
    """Variances in %^2 of a command that errs at each scan by itself (n,), and of a break-away force alone."""

    command: FloatArray
    own: float


@dataclass(frozen=True, slots=True)
class Paths:
    """The slips of every segment, the scatter of the break-away force and the error of the command, both in %."""

    slips: tuple[Slips, ...]
    scatter: float
    # Standard deviation; whether a sliding stem stopped is in doubt where the command is not exact.
    error: float = 0.0
    # None where a stem lands exactly where the law puts it.
    landing: Landing | None = None
    # Log of the share that these slips have in all slips that PV allows: a slip a little earlier may fit as well.
    share: float = 0.0
    # Standard deviation of the time of a slip, as a share of the time from one command to the next.
    jitter: float = 0.0
    # Whether the command errs at each unseen scan by itself; else a slip has its error at both ends of the stick.
    by_scan: bool = False

    @property
    def count(self) -> int:
        """Number of slips."""
        return sum(s.count for s in self.slips)

    @property
    def own_variance(self) -> float:
        """Variance of the break-away force alone in %^2: a slip compares two commands, each with its error."""
        return max(self.scatter**2 - 2.0 * self.at_ends**2, _LEAST_OWN * self.scatter**2)

    @property
    def at_ends(self) -> float:
        """Error of the command in % that is in the scatter, at both ends of a stick."""
        return 0.0 if self.by_scan else self.error

    def scan_errors(self, samples: int, parts: int) -> ScanErrors | None:
        """The errors of a command on a grid of so many samples, of which one in `parts` is a row; None if not by scan.
        """
        if not self.by_scan:
            return None
        return ScanErrors(np.where(np.arange(samples) % parts == 0, 0.0, self.error**2), self.own_variance)

    def with_error(self, error: float) -> Paths:
        """The same slips with another error of the command, which is also that of a landing."""
        landing = self.landing and replace(self.landing, ratio=self.landing.ratio * error / self.error)
        return replace(self, error=error, landing=landing)

    def description(self) -> dict[str, Any]:
        """The path as a study stores it."""
        landing = self.landing and {"ratio": self.landing.ratio, "values": dict(self.landing.values)}
        return {"scatter": self.scatter, "error": self.error, "landing": landing, "share": self.share,
                "jitter": self.jitter, "by_scan": self.by_scan,
                "slips": [{"at": s.at.tolist(), "kind": s.kind.tolist(), "known": s.known, "size": s.size}
                          for s in self.slips]}

    def of(self, segment: int) -> Paths:
        """The path of one segment."""
        return replace(self, slips=self.slips[segment:segment + 1])


def paths_from(stored: Mapping[str, Any]) -> Paths:
    """The inverse of `Paths.description`; ValueError for events that no path has."""
    scatter, error = float(stored["scatter"]), float(stored["error"])
    if not (0.0 < scatter < math.inf and 0.0 <= error < math.inf):
        raise ValueError(f"the scatter {scatter:g} % or the error {error:g} % of its path is out of range")
    slips = []
    for one in stored["slips"]:
        at, kind = np.array(one["at"], dtype=np.int64), np.array(one["kind"], dtype=np.int64)
        known, size = int(one["known"]), int(one["size"])
        ordered = at.ndim == 1 and at.shape == kind.shape and bool((np.diff(at) >= 0).all())
        if not (ordered and 0 <= known <= size and np.isin(kind, (-1, 1, 2)).all()
                and (not at.size or (at[0] >= 0 and at[-1] < size))):
            raise ValueError("its path holds events out of order, or beyond its samples")
        slips.append(Slips(at, kind, known, size))
    if not slips:
        raise ValueError("its path is empty")
    told = stored.get("landing")
    landing = Landing(float(told["ratio"]), tuple((str(k), float(v)) for k, v in told["values"].items())) \
        if told else None
    if landing is not None and not 0.0 < landing.ratio < math.inf:
        raise ValueError(f"the error {landing.ratio:g} with which its stem lands is out of range")
    share = float(stored.get("share", 0.0))
    if not -math.inf < share <= 0.0:
        raise ValueError(f"the share {share:g} of its path is out of range")
    jitter = float(stored.get("jitter", 0.0))
    if not 0.0 <= jitter < math.inf:
        raise ValueError(f"the jitter {jitter:g} of its slips is out of range")
    return Paths(tuple(slips), scatter, error, landing, share, jitter, bool(stored.get("by_scan", False)))
