"""Fuzz targets on the command line: loop lists, and whole command lines with any value for any option.

The options are read from the command line itself, so that a new one is fuzzed as soon as it exists.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import random
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fuzz_inputs as make

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


class Broken(AssertionError):
    """A result or a refusal that breaks a promise."""


@functools.cache
def memory() -> str | None:
    """A folder that costs no disk, where there is one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


# --- loop lists

_LIST_CELLS = (
    *make.TOKENS, "FIC101", "FIC101.PV", "FIC101.OP", "../../etc/passwd", "a/b", "..", ".", "CON", "nul.json",
    "x" * 300, "0,100", "100,0", "4:20", "4;20", "nan,1", "0,inf", "1e400,2", "0", "=HYPERLINK(1)", "<b>", "a\0b", "Ⅷ",
    "FIC 101",
)
_LIST_HEADS = ("loop", "sp", "pv", "op", "position", "span_op", "span_pv")


def make_list(rng: random.Random) -> bytes:
    """A loop list: sensible with odd cells, or damaged."""
    sep = rng.choice((",", ",", ";"))
    head = list(_LIST_HEADS[: rng.choice((4, 7, 7))])
    if rng.random() < 0.2:
        head[rng.randrange(len(head))] = rng.choice((*make.NAMES, *_LIST_HEADS))
    rows = [head]
    for i in range(rng.choice((0, 1, 3, 3, 8))):
        row = [f"FIC{100 + i}", "r", "y", "u", "", "", ""][: len(head)]
        for _ in range(rng.choice((0, 0, 1, 1, 3))):
            row[rng.randrange(len(row))] = rng.choice(_LIST_CELLS)
        rows.append(row[: rng.choice((len(row), len(row), 2))] if rng.random() < 0.1 else row)
    quote = rng.choice((True, True, False))
    lines = [sep.join('"' + c.replace('"', '""') + '"' if quote and c else c for c in row) for row in rows]
    data = (rng.choice(("", "", "\ufeff")) + rng.choice(("\n", "\r\n")).join(lines)).encode("utf-8", "replace")
    return make.damage(rng, data, 3) if rng.random() < 0.4 else data


def run_list(data: bytes) -> None:
    """Reads a loop list; every loop has its tags, ranges that are ranges, and a file of its own inside the folder."""
    from stictionid.batch.plan.loop_lists import read_list
    from stictionid.batch.plan.tasks import key_for

    with tempfile.NamedTemporaryFile(suffix=".csv", dir=memory()) as file:
        file.write(data)
        file.flush()
        listed = read_list(Path(file.name))
    keys = set()
    for one in listed:
        if not (one.loop and one.pv and one.op):
            raise Broken(f"a loop without its tags: {one}")
        for span in (one.span_op, one.span_pv):
            if span is not None and not (float("-inf") < span[0] < span[1] < float("inf")):
                raise Broken(f"no range: {one}")
        key = key_for(one.loop)
        folder = Path("/studies")
        if os.path.dirname(os.path.normpath(folder / f"{key}.json")) != str(folder) or len(key) > 100:
            raise Broken(f"{one.loop!r} leads out of the folder: {key!r}")
        keys.add(key.casefold())
    if len(keys) != len(listed):
        raise Broken(f"loops share a file: {sorted(keys)}")


# --- whole command lines

_NUMBERS = ("0", "1", "-1", "2", "3", "5.5", "nan", "inf", "-inf", "1e300", "1e-300", "5e-324", "1e18", "-0.0", "1e400",
            "99999999999999999999", "x", "", " ", "1,5", "٣", "0x10", "1_0", "50%", "--", "1e-9", "12345678901", "0.5")
_WORDS = (
    *make.TOKENS, "auto", "arx", "ellipse", "jelali", "chen", "karnopp:mass=2", "karnopp:mass=nan", "lugre:=", "all",
    "kano:S=1", "chen:", ":", "=", "foptd", "itptd", "tank", "hold", "corner", "screen", "identify", "extra-lag",
    "extra-lag:second_time_constant_s=8", "travel-limit:upper=nan", "travel-limit:upper", "step-disturbance@load",
    "no-such-thing", "../x", "0:5", "1e300:1e300", "nan:1", "5:", "0,100", "100,0", "nan,1", "4,20", "tcp://", "iso",
    "PV", "OP", "SP", "time", "7", "1=AUTO", "rows=5", "file=0", "line=1e99", "unpacked=1", "utf-16", "UTC", "tab",
    "wide", "long", "svg", "png", "\x1b[31m", "x" * 3000, "%s", "{}", "\ud7ff",
)
# Nothing here may lead to a place that root could write to, outside the folder of the run.
_PATHS = ("data.csv", "data.csv", "data.parquet", "study.json", "old.json", "none.csv", ".", "/proc/nonexistent/x", "",
          "/dev/null", "x" * 300, "new.json", "new.md", "new.html", "new.csv", "new.parquet", "new.png", "noise.bin",
          "profile.toml", "list.csv", "-", "new", "empty.csv", "a\nb.csv", "data.csv/x", "*.csv", "/dev/full")
# What a command line may not be asked here: a cluster that is waited for, and work that is meant to be long.
_LEFT_OUT = {"scheduler", "jobs", "loops_count"}
_COMMANDS_LEFT_OUT = {"selftest"}


@dataclass(frozen=True)
class Parameter:
    """One argument or option of a command: the words that name it, and what kind of value it takes."""

    name: str
    words: tuple[str, ...]
    kind: str
    required: bool


@functools.cache
def commands() -> dict[str, tuple[Parameter, ...]]:
    """Every command with its parameters, as its function declares them."""
    import inspect
    from typing import get_args

    from stictionid.cli.app import app

    found = {}
    for command in app.registered_commands:
        assert command.callback is not None
        parameters = []
        for p in inspect.signature(command.callback, eval_str=True).parameters.values():
            kind, info = get_args(p.annotation)[:2]
            # Inside Annotated the first name stands where typer expects the default.
            declared = [word for words in (info.default, *(info.param_decls or ())) if isinstance(words, str)
                        for word in words.split("/")]
            words = () if type(info).__name__ == "ArgumentInfo" else tuple(
                word for word in declared or ["--" + p.name.replace("_", "-")] if word.startswith("-"))
            text = str(kind)
            parameters.append(Parameter(p.name, words, next(k for k in ("bool", "int", "float", "Path", "str")
                                                            if k in text), p.default is inspect.Parameter.empty))
        found[command.name or command.callback.__name__] = tuple(parameters)
    return {name: found[name] for name in sorted(found) if name not in _COMMANDS_LEFT_OUT}


def _value(rng: random.Random, kind: str) -> str:
    if rng.random() < 0.1:
        return rng.choice(make.TOKENS)
    if kind in ("int", "float"):
        return rng.choice(_NUMBERS)
    return rng.choice(_PATHS if kind == "Path" else (*_WORDS, *_NUMBERS))


def make_command(rng: random.Random) -> bytes:
    """One command line: arguments that mostly exist, one to four options with any value."""
    name = rng.choice(list(commands()))
    parameters = commands()[name]
    words = [name]
    for parameter in parameters:
        if not parameter.words:
            if parameter.required or rng.random() < 0.3:
                fits = {"laws": "chen", "effects": "extra-lag"}.get(
                    name, "study.json" if parameter.name in ("study", "studies") else "data.csv")
                words += [fits if rng.random() < 0.8 else rng.choice((*_PATHS, *_WORDS))]
        elif parameter.required:
            words += [parameter.words[-1], rng.choice(("new.csv", "new.csv", "new", *_PATHS))]
    options = [p for p in parameters if p.words and p.name not in _LEFT_OUT]
    chosen = rng.sample(options, min(len(options), rng.choice((1, 1, 2, 2, 4))))
    for option in chosen:
        words.append(rng.choice(option.words))
        if option.kind != "bool":
            words.append(_value(rng, option.kind))
    if name == "simulate" and not any(o.name == "duration" for o in chosen):
        words += ["--duration", "4"]
    if rng.random() < 0.05:
        words.insert(rng.randrange(len(words) + 1), rng.choice((*_WORDS, "--help", "--version", "-x", "--no-such")))
    return json.dumps(words).encode("utf-8", "replace")


@functools.cache
def _furniture() -> dict[str, bytes]:
    """The files a command line finds: exports that are too short for an answer, studies, and rubbish."""
    import random as chance

    studies = [p.read_bytes() for p in sorted(GOLDEN.glob("study_schema_*.json"))]
    return {"data.csv": make.seeds()[0], "data.parquet": make.arrow_table(chance.Random(1)), "study.json": studies[-1],
            "old.json": studies[0], "noise.bin": chance.Random(2).randbytes(300), "profile.toml": b"decimal = '.'\n",
            "list.csv": b"loop,pv,op\nFIC101,PV,OP\n", "empty.csv": b""}


def run_command(data: bytes) -> str:
    """Runs a command line in a folder of its own; what it wrote is whole, its exit code is the contract's.

    "read" for exit 0, 4 and an abstention, "refused" for a refusal of one sentence.
    """
    from stictionid.cli import main

    words = json.loads(data)
    outer, before = tempfile.mkdtemp(dir=memory()), os.getcwd()
    folder = os.path.join(outer, "here")  # so that ../x stays in a folder of the run's own
    os.mkdir(folder)
    streams = sys.stdin, sys.argv
    out, err = io.StringIO(), io.StringIO()
    code: Any = 0
    try:
        for name, content in _furniture().items():
            (Path(folder) / name).write_bytes(content)
        os.chdir(folder)
        sys.stdin = io.TextIOWrapper(io.BytesIO(b""))
        sys.argv = ["stictionid", *words]
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
            except SystemExit as end:
                code = end.code
        for left in Path(outer).rglob("*.part"):
            raise Broken(f"{words}: left {left.name} behind")
    finally:
        os.chdir(before)
        sys.stdin, sys.argv = streams
        shutil.rmtree(outer, ignore_errors=True)
    return _judge(words, code, out.getvalue(), err.getvalue())


def _judge(words: list[str], code: Any, out: str, err: str) -> str:
    if "Traceback" in err or code not in (0, 2, 3, 4):
        raise Broken(f"{words}: exit {code}\n{err[-3000:]}")
    said = [line for line in err.splitlines() if line.startswith("stictionid: ")]
    if code == 2 and len(said) != 1:
        raise Broken(f"{words}: refused in {len(said)} sentences: {err[-500:]!r}")
    if code == 3 and not said and "undecided" not in out:
        raise Broken(f"{words}: exit 3 without a reason: {err[-500:]!r} {out[-200:]!r}")
    if any(len(line) > 1200 for line in said):
        raise Broken(f"{words}: no sentence is that long: {said[0][:300]!r}…")
    if code == 0 and "--json" in words and "--help" not in words and "-h" not in words and "--version" not in words:
        json.loads(out, parse_constant=_no_constant)
    return "refused" if said else "read"


def _no_constant(text: str) -> None:
    raise Broken(f"{text} in JSON")
