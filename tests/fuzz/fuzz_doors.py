"""Fuzz targets (doors): each makes inputs for one entry of the program and runs one of them.

Inputs are bytes, whatever they mean. A run ends in a consistent result or in a refusal of one sentence; everything else
is raised as it is, or as `Broken`.
"""

from __future__ import annotations

import copy
import functools
import io
import json
import math
import random
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fuzz_inputs as make
from fuzz_commands import GOLDEN, Broken, make_command, make_list, run_command, run_list
from fuzz_commands import memory as _memory

from stictionid.errors import StictionidError
from stictionid.historian.bytes.options import ReadOptions


@dataclass(frozen=True)
class Door:
    """`make` draws one input, `run` puts it through; `share` is how many of the executions it gets."""

    make: Callable[[random.Random], bytes]
    run: Callable[[bytes], object]
    share: int


def put_through(door: Door, data: bytes) -> str:
    """"read" or "refused"; raises whatever a user must never see."""
    try:
        said = door.run(data)
    except StictionidError as refusal:
        if not refusal.message or "\n" in refusal.message or len(refusal.message) > 1000:
            raise Broken(f"refusal is not one sentence: {refusal.message[:300]!r}") from None
        if refusal.exit_code not in (2, 3) or not refusal.hint:
            raise Broken(f"refusal without exit code 2 or 3, or without a hint: {refusal.message[:300]!r}") from None
        return "refused"
    return "refused" if said == "refused" else "read"


def _check(reading: object) -> None:
    from stictionid.historian.reading import Reading

    assert isinstance(reading, Reading)
    rows, loop = reading.rows, reading.loop
    if rows["in"] != rows["used"] + sum(v for k, v in rows.items() if k not in ("in", "used")):
        raise Broken(f"rows don't add up: {rows}")
    if sum(s["samples"] for s in reading.segments) != loop.samples or not loop.samples:
        raise Broken(f"segments don't add up: {reading.segments}")
    if not (math.isfinite(loop.step_s) and loop.step_s > 0):
        raise Broken(f"step {loop.step_s}")
    json.dumps([reading.rows, reading.columns, reading.samples, list(reading.assumptions), loop.origin.start,
                [f.statement for f in reading.findings]])


def _read(data: bytes) -> None:
    from stictionid.historian import read

    _check(read(io.BytesIO(data)))


_SPECS = ({}, {"process": "integrator", "increments": True}, {"taps": (-1.2, 0.5, -0.1)})


def _models(data: bytes) -> None:
    """An export whose cells are missing in a pattern, up to models on it with noise models of their own."""
    import numpy as np

    from stictionid.fit.noise.bias_correction import noise_of
    from stictionid.historian import read
    from stictionid.model.segments import bind_model
    from stictionid.model.spec import Spec
    from stictionid.numerics.autoregression import irreducible_error
    from stictionid.record.oscillation import find_range
    from stictionid.record.preconditions import check, swing_of, time_scale_s
    from stictionid.record.segments import chosen

    reading = read(io.BytesIO(data))
    _check(reading)
    piece, _ = chosen(reading.loop)
    found = find_range(piece)
    check(piece, found)
    for spec in _SPECS:
        model = bind_model(piece, Spec(**spec), s_max=swing_of(piece, found), period_s=time_scale_s(piece, found))
        values = model.values(np.full((1, model.space.size), 0.5))[:, 0]
        e = model.evaluate(values)
        if not math.isfinite(e.sse) or not np.isfinite(model.costs_of(values[:, None])).all():
            raise Broken(f"no cost of {spec}")
        taps = noise_of(model, e, np.array([1.0, -1.0]) if model.spec.increments else np.ones(1), 8)
        floor = irreducible_error(model.context.process_value, e.position_means, model.good(), 1, piece.starts)
        if not np.isfinite(taps).all() or not (floor is None or math.isfinite(floor)):
            raise Broken(f"noise of {spec}: {taps}, {floor}")


def _options(data: bytes) -> None:
    """Option values as the command line hands them over, on an export that reads well."""
    from stictionid.cli.common.reading import OPTIONS, collect
    from stictionid.historian import read

    said = {name: default for name, _, default in OPTIONS}
    content = json.loads(data)
    said |= content["options"]
    _check(read(io.BytesIO(make.seeds()[content["seed"]]), options=collect(said)))


_TEXTS = (
    *make.TOKENS, "0,100", "100,0", "4,20", "nan,1", "0,inf", "-inf,inf", "1e308,-1e308", "0,1e-320", "50,50.0001",
    "14:00:05", "5", "1e9", "-5", "dmy", "iso", "epoch", "excel", "excel1904", "filetime", "seconds", "wide", "long",
    "paired", "cp1252", "utf-16", "gbk", "idna", "base64", "rot13", "unicode_escape", "Europe/Berlin", "UTC", "../x",
    "America/Chicago", "+02:00", "tab", "space", "1", "2", "3", "4", "99", "FIC101", "A1", "1=AUTO", "x=MAN", "=",
)
_TEXT_OPTIONS = (
    "sp", "pv", "op", "position", "time", "mode", "quality", "loop", "span_pv", "span_op", "split", "start", "end",
    "decimal", "zone", "time_format", "encoding", "separator", "shape",
)


def _make_options(rng: random.Random) -> bytes:
    names = rng.sample(_TEXT_OPTIONS, rng.choice((1, 1, 2, 4)))
    options: dict[str, object] = {name: rng.choice(_TEXTS) for name in names}
    for name, values in (("step_s", (1.0, 2.0, 0.1, 1e-12, 1e12, 1e300, -1.0, float("nan"), 5e-324)),
                         ("header", (0, 1, 2, 50, 10**9)), ("dayfirst", (True, False)), ("reverse_op", (True,)),
                         ("keep_manual", (True,)), ("no_guess", (True,)), ("extra", (["SP"], ["TI7", "3"], [""])),
                         ("mode_map", (["1=AUTO"], ["MAN=AUTO"], ["=x"], ["a"], ["AUTO=off"])),
                         ("limit", (["rows=5"], ["line=9"], ["rows"], ["file=1e99"], ["columns=2"], ["unpacked=0"])),
                         ("keep_startup", (True,)), ("sentinels", ([50.0], [float("nan")], [1e308], [0.0, -1.0]))):
        if rng.random() < 0.12:
            options[name] = rng.choice(values)
    return json.dumps({"seed": rng.randrange(len(make.seeds())), "options": options}).encode()


def _said(data: bytes) -> None:
    """Reading options as a study keeps them: the file was written by anyone."""
    from stictionid.historian import options_from, read

    _check(read(io.BytesIO(make.seeds()[0]), options=options_from(json.loads(data))))


def _make_said(rng: random.Random) -> bytes:
    names = [*ReadOptions().__slots__, "no such option"]  # type: ignore[attr-defined]
    names = [n for n in names if n != "profile"]
    values = (*_JSON, *_TEXTS, 1, 0.5, [0, 100], [0.0, float("inf")], {"1": "AUTO"}, {"1": 1}, ["SP"], [50.0])
    return json.dumps({rng.choice(names): rng.choice(values) for _ in range(rng.choice((1, 1, 2)))}).encode()


def _profile(data: bytes) -> None:
    from stictionid.historian import ReadOptions, read

    with tempfile.NamedTemporaryFile(suffix=".toml", dir=_memory()) as file:
        file.write(data)
        file.flush()
        _check(read(io.BytesIO(make.seeds()[0]), options=ReadOptions(profile=file.name)))


_PROFILE = b'# stictionid site profile\nseparator = ","\ndecimal = "."\ndayfirst = true\nspan_op = [0, 100]\n' \
           b'mode_map = { "11" = "AUTO", "22" = "MAN" }\nsentinels = [-9999, 1e30]\nheader = 1\n'


def _folder(data: bytes) -> None:
    """One file per tag: the input holds the files one behind the other."""
    from stictionid.historian import read

    names = ("FIC101.PV.csv", "FIC101.OP.csv", "FIC101.SP.txt", "b.gz")
    with tempfile.TemporaryDirectory(dir=_memory()) as folder:
        for name, part in zip(names, data.split(b"\x1e"), strict=False):
            (Path(folder) / name).write_bytes(part)
        _check(read(folder))


def _make_folder(rng: random.Random) -> bytes:
    files = []
    shared = make.stamps_of(rng, 12)
    for _ in range(rng.choice((2, 2, 3))):
        stamps = shared if rng.random() < 0.8 else make.stamps_of(rng, 12)
        cells = make.signal(rng, 12, sane=rng.random() < 0.8)
        sep = rng.choice(",;\t")
        text = f"Time{sep}Value\n" + "".join(f"{s}{sep}{c}\n" for s, c in zip(stamps, cells, strict=True))
        files.append(text.encode("utf-8", "replace"))
    joined = b"\x1e".join(files)
    return make.damage(rng, joined, 2) if rng.random() < 0.5 else joined


def _study(data: bytes) -> None:
    from stictionid.errors import DataError
    from stictionid.record.study import study_from_json, to_json

    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise DataError("not text", "the command line refuses it the same way") from None
    study = study_from_json(text)
    if study_from_json(to_json(study)) != study and "NaN" not in text and "Infinity" not in text and "e" not in text:
        raise Broken("a study does not survive writing and reading")


@functools.cache
def _studies() -> tuple[bytes, ...]:
    return tuple(p.read_bytes() for p in sorted(GOLDEN.glob("study_schema_*.json")))


_JSON = (None, True, 0, -1, 1e308, 10**400, "", "x", "\ud800", [], {}, [None], {"a": []}, float("nan"), [[[]]],
         "0" * 50)


def _make_study(rng: random.Random) -> bytes:
    if rng.random() < 0.4:
        return make.damage(rng, rng.choice(_studies())[:20_000] if rng.random() < 0.5 else _studies()[-1])
    content = json.loads(_studies()[-1] if rng.random() < 0.7 else _studies()[0])
    for _ in range(rng.choice((1, 1, 2, 5))):
        node = content
        for _ in range(rng.randrange(6)):
            below = node.values() if isinstance(node, dict) else node
            inner = [v for v in below if isinstance(v, (dict, list)) and v]
            if not inner or rng.random() < 0.2:
                break
            node = rng.choice(inner)
        key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
        if rng.random() < 0.2:
            del node[key]
        else:
            node[key] = copy.deepcopy(rng.choice(_JSON))
        if not content:
            break
    return json.dumps(content).encode("utf-8", "replace")


@functools.cache
def _parquets() -> tuple[bytes, ...]:
    return tuple(make.arrow_table(random.Random(i)) for i in range(60))


def _make_bytes(rng: random.Random) -> bytes:
    return make.damage(rng, rng.choice(make.seeds()))


def _make_packed(rng: random.Random) -> bytes:
    packed = make.pack(rng, rng.choice(make.seeds()))
    return make.damage(rng, packed, 3) if rng.random() < 0.7 else packed


def _make_noise(rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return rng.randbytes(rng.randrange(400))
    return " ".join(rng.choice(make.TOKENS) for _ in range(rng.randrange(60))).encode("utf-8", "replace")


DOORS = {
    "text, damaged bytes": Door(_make_bytes, _read, 18),
    "text, random tables": Door(make.text_table, _read, 17),
    "text, packed or encoded": Door(_make_packed, _read, 11),
    "text, missing cells": Door(make.masked, _models, 1),
    "text, noise": Door(_make_noise, _read, 24),
    "Parquet, damaged bytes": Door(lambda rng: make.damage(rng, rng.choice(_parquets()), 3), _read, 30),
    "Parquet, random tables": Door(make.arrow_table, _read, 6),
    "folder, one file per tag": Door(_make_folder, _folder, 1),
    "options": Door(_make_options, _options, 4),
    "site profile": Door(lambda rng: make.damage(rng, _PROFILE, 3), _profile, 3),
    "options kept in a study": Door(_make_said, _said, 2),
    "study JSON": Door(_make_study, _study, 14),
    "loop list": Door(make_list, run_list, 12),
    "command line": Door(make_command, run_command, 1),
}
"""Every door by its name; executions are dealt out by `share`."""


def name_of(file: Path) -> str:
    """The door a file of the corpus belongs to."""
    return next(name for name in DOORS if file.name.startswith(slug(name) + "-"))


def slug(name: str) -> str:
    """A door's name as the beginning of a file name."""
    return "".join(c if c.isalnum() else "_" for c in name.lower())
