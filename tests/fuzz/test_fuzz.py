"""A short sample of the fuzzing, and every input that ever failed; `run.py` in this folder runs it at length."""

from __future__ import annotations

import io
import random
from pathlib import Path

import pytest
from fuzz_doors import DOORS, Door, _read, name_of, put_through
from fuzz_inputs import NAMES, TOKENS, seeds
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.bin"))
READ = Door(lambda rng: b"", _read, 1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("file", CORPUS, ids=lambda f: f.stem)
def test_what_failed_once_is_read_or_refused(file):
    put_through(DOORS[name_of(file)], file.read_bytes())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", DOORS)
def test_a_sample_of_every_door(name):
    rng = random.Random(f"sample of {name}")
    outcomes = [put_through(DOORS[name], DOORS[name].make(rng)) for _ in range(25)]
    assert set(outcomes) <= {"read", "refused"}


def test_every_seed_reads():
    from stictionid.errors import UsageError
    from stictionid.historian import read

    for seed in seeds():
        try:
            assert read(io.BytesIO(seed)).loop.samples
        except UsageError as several:
            assert "loops" in several.message


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(seeds()), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 30), st.binary(max_size=8)),
                                          max_size=6))
def test_bytes_put_anywhere(seed, changes):
    for at, gone, new in changes:
        seed = seed[:at] + new + seed[at + gone :]
    put_through(READ, seed)


CELL = st.one_of(st.sampled_from(TOKENS), st.floats(allow_nan=True).map(repr), st.integers().map(str),
                 st.datetimes().map(str), st.text(max_size=6))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.sampled_from(NAMES), min_size=2, max_size=5).flatmap(
    lambda names: st.tuples(st.just(names), st.lists(st.lists(CELL, min_size=len(names), max_size=len(names)),
                                                     max_size=15))), st.sampled_from(",;\t| "))
def test_tables_of_anything(table, separator):
    names, rows = table
    text = "\n".join(separator.join(row) for row in [names, *rows])
    put_through(READ, text.encode("utf-8", "replace"))
