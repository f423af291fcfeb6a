"""Numbers that are no measurements: sentinels, and system states that a collector wrote as their code."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...record.loop import Finding
from ...typing import BoolArray, FloatArray
from ..grid.grid import Frame, long_runs
from ..series.shaped import Shaped
from ..words.cells import shown
from ..words.findings import finding
from ..words.states import NUMERIC_STATES, SENTINELS

FAR = 5.0
"""A sentinel or code lies at least this many times the spread of the rest away from it."""
DROPOUTS = (0.0, -1.0)
"""Numbers that collectors write when a read fails."""
MAX_DROPOUT_RUN = 3
"""Samples in a row at 0 or -1 that may be a failed read; longer is a process that stood still."""
MAX_CODE_SHARE = 0.2
"""Share of samples above which a number is data, not a code."""


def blank_codes(frame: Frame, shaped: Shaped, said: tuple[float, ...]) -> list[Finding]:
    """Turn sentinels and codes into "no value", in place; a finding for each kind, and one for states as words."""
    findings = []
    for role in ("process_value", "output", "setpoint", "position"):
        if words := shaped.words.get(role):
            findings.append(_words_finding(role, words))
        if role not in frame.values:
            continue
        values = frame.values[role]
        hits = np.isin(values, said) if said else np.zeros(values.size, np.bool_)
        guessed = (_guessed(values) | _dropouts(values, role)) & ~hits
        hits |= guessed
        if not hits.any():
            continue
        seen = {f"{v:g}": int(c) for v, c in zip(*np.unique(values[hits], return_counts=True), strict=True)}
        frame.values[role] = np.where(hits, np.nan, values)
        listed = ", ".join(f"{v} ({c})" for v, c in list(seen.items())[:5])
        findings.append(finding("code-as-number", {"values": seen}, role=role.replace("_", " "), count=int(hits.sum()),
                                listed=listed))
        if guessed.any():
            shaped.guesses.append(f"{role.replace('_', ' ')}: {listed} taken for codes (--sentinel VALUE)")
    return findings


def _guessed(values: FloatArray) -> BoolArray:
    """True where a value is a known sentinel or a state code, isolated and far outside the rest."""
    low, high = (float(f(values)) for f in (np.nanmin, np.nanmax)) if not np.isnan(values).all() else (0.0, 0.0)
    if high < NUMERIC_STATES.start and low > max(s for s in SENTINELS if s < 0):
        return np.zeros(values.size, np.bool_)
    whole = values == np.rint(values)
    suspects = np.isin(values, SENTINELS) | (whole & (values >= NUMERIC_STATES.start) & (values < NUMERIC_STATES.stop))
    return _far(values, suspects, lambda rest: FAR * max(float(rest.std()), 1e-12))


def _dropouts(values: FloatArray, role: str) -> BoolArray:
    """True where a measurement falls to exactly 0 or -1 for a few samples, far from all others: a failed read."""
    if role not in ("process_value", "position"):
        return np.zeros(values.size, np.bool_)
    here = np.isin(values, DROPOUTS)
    return _far(values, here, lambda rest: float(np.ptp(rest)) + 1e-12) & ~long_runs(here, MAX_DROPOUT_RUN + 1)


def _far(values: FloatArray, codes: BoolArray, margin: Callable[[FloatArray], float]) -> BoolArray:
    """Those codes that lie beyond the range of the other values by a margin; none where there are too many."""
    rest = values[~codes & ~np.isnan(values)]
    if not 0 < codes.mean() <= MAX_CODE_SHARE or rest.size < 10:
        return np.zeros(values.size, np.bool_)
    far = margin(rest)
    return np.asarray(codes & ((values > rest.max() + far) | (values < rest.min() - far)))


def _words_finding(role: str, words: dict[str, int]) -> Finding:
    listed = ", ".join(f"{shown(w)} ({c})" for w, c in list(words.items())[:5])
    total = sum(words.values())
    return finding("state-as-text", {"texts": dict(list(words.items())[:20]), "cells": total}, listed=listed,
                   role=role.replace("_", " "), count=total)
