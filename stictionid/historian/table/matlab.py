"""MATLAB reader (.mat up to v7, scipy.io): every struct with vectors of one length is a loop, named by its path.

The International Stiction Data Base (Jelali and Huang, 2010) is such a file: `cdata.<industry>.loop<k>` with the
vectors t, SP, PV, OP, the step Ts in seconds, and comments. Vectors at the top of a file are one loop without a name.
"""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...errors import DataError
from ..bytes.arrow import numbers, timestamps
from ..bytes.source import Limits, Source, in_short
from ..words.cells import brief, shown
from ..words.roles import role_of, tidy
from .columns import names_of
from .parts import Part
from .table import Table, table_from_arrow

MIN_VALUES = 8
"""Least number of values of a vector that counts as a signal; shorter ones are parameters."""
MAX_DEPTH = 8
"""Levels of structs that are searched for vectors."""
MAX_ITEMS = 10_000
"""Items of a struct array or cell that are searched."""
DATENUM = (690_000.0, 790_000.0)
"""Days of MATLAB's datenum from 1889 to 2162."""
DATENUM_EPOCH = 719_529.0
"""datenum of 1970-01-01, days."""
_STEPS = ("ts", "dt", "t step", "step", "step s", "sampling time", "sample time", "sampling period", "tsample", "h")
_MOST_SHOWN = 300
_SAVE_STRUCT = "in MATLAB: s = table2struct(T, 'ToScalar', true); save('loop.mat', '-struct', 's', '-v7')"


@dataclass
class _Node:
    """Contents of one struct: vectors (n,), matrices' columns among them, numbers, and texts, by field name."""

    path: str
    vectors: dict[str, NDArray[Any]] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)


def parts_of_matlab(source: Source, limits: Limits) -> list[Part]:
    """The structs that hold a table of vectors. DataError for what MATLAB writes in no open way, or without vectors."""
    content = _loaded(source, limits)
    opaque = [name for name, value in content.items() if _is_opaque(value)]
    plain = {name: v for name, v in content.items() if not name.startswith("__") and name not in opaque}
    found = [node for node in _nodes("", plain, 0) if len(node.vectors) >= 2]
    if not found:
        if opaque:
            raise DataError(f"{source.name} holds {shown(opaque[0])}, a table, timetable or object that only MATLAB "
                            "can read", f"save its columns as vectors, {_SAVE_STRUCT}")
        raise DataError(f"{source.name} has no two vectors of {MIN_VALUES} values or more; it holds: "
                        f"{', '.join(brief(n) for n in list(plain)[:8]) or 'nothing'}",
                        "save PV, OP and t as vectors: save('loop.mat', 'PV', 'OP', 't', '-v7')")
    trunk = _common(tuple(node.path for node in found))
    return [_part(node, node.path[len(trunk):], source, limits) for node in found]


def _loaded(source: Source, limits: Limits) -> dict[str, Any]:
    """The variables of a file by name. DataError where it is v7.3, damaged or above a limit."""
    if source.data[:16].startswith(b"MATLAB 7.3") or b"\x89HDF" in source.data[:1024]:
        raise DataError(f"{source.name} is a MATLAB file of version 7.3 (HDF5), which is not read",
                        "in MATLAB: load it and save it again with save('loop.mat', '-v7')")
    from scipy.io import loadmat, whosmat

    try:
        stated = sum(8 * math.prod(shape) for _, shape, _ in whosmat(io.BytesIO(source.data)))
        limits.check("unpacked", stated, source.name, "save fewer variables")
        return dict(loadmat(io.BytesIO(source.data), squeeze_me=True, struct_as_record=False, chars_as_strings=True))
    except NotImplementedError as error:
        raise DataError(f"{source.name} is a MATLAB file of a version that is not read: {in_short(error)}",
                        "in MATLAB: load it and save it again with save('loop.mat', '-v7')") from None
    except DataError:
        raise
    except Exception as error:  # damaged bytes raise whatever the place they damage raises
        raise DataError(f"{source.name} is a damaged MATLAB file: {in_short(error)}",
                        "save or copy it again") from None


def _is_opaque(value: Any) -> bool:
    kind = type(value).__name__
    return kind in ("MatlabOpaque", "MatlabFunction") or (
        getattr(value, "dtype", None) is not None and bool(value.dtype.names) and "s2" in value.dtype.names)


def _nodes(path: str, fields: dict[str, Any], depth: int) -> Iterator[_Node]:
    """The struct at `path`, and every struct, struct array and cell below it."""
    node = _Node(path)
    below: list[tuple[str, dict[str, Any]]] = []
    for name, value in fields.items():
        at = f"{path}.{name}" if path else name
        inner = _fields(value)
        if inner is not None:
            below.append((at, inner))
            continue
        array = np.asarray(value)
        if array.dtype == object:
            below += [(f"{at}{k}", one) for k, item in enumerate(array.ravel()[:MAX_ITEMS], 1)
                      if (one := _fields(item)) is not None]
        elif array.dtype.kind in "US":
            node.words[name] = " ".join(str(a) for a in array.ravel()[:20])
        elif array.dtype.kind in "fiub":
            _take_numbers(node, name, array)
    yield node
    if depth < MAX_DEPTH:
        for at, inner in below:
            yield from _nodes(at, inner, depth + 1)


def _fields(value: Any) -> dict[str, Any] | None:
    names = getattr(value, "_fieldnames", None)
    return None if names is None else {str(n): getattr(value, n) for n in names}


def _take_numbers(node: _Node, name: str, array: NDArray[Any]) -> None:
    if array.ndim == 1 and array.size >= MIN_VALUES:
        node.vectors[name] = array
    elif array.ndim == 2 and array.shape[0] >= MIN_VALUES and array.shape[1] >= 1:
        node.vectors |= {f"{name}_{k}": array[:, k - 1] for k in range(1, array.shape[1] + 1)}
    elif array.size == 1:
        node.scalars[name] = float(array.ravel()[0])


def _common(paths: tuple[str, ...]) -> str:
    """The beginning that all paths share, up to a dot: the name of the variable that holds all loops."""
    if len(paths) < 2:
        return ""
    heads = zip(*(p.split(".")[:-1] for p in paths), strict=False)
    shared = [words[0] for words in takewhile(lambda words: len(set(words)) == 1, heads)]
    return ".".join(shared) + "." if shared else ""


def _part(node: _Node, name: str, source: Source, limits: Limits) -> Part:
    file = f"{source.name}, {name}" if name else source.name
    limits.check("columns", len(node.vectors), file)
    vectors = _of_one_length(node)
    # Step in seconds that a field states.
    step = next((v for n, v in node.scalars.items() if tidy(n) in _STEPS and 0.0 < v < 1e8), None)
    limits.check("rows", len(next(iter(vectors.values()))), file, "cut it into pieces")

    def whole() -> Table:
        for role in ("process_value", "output"):
            _refuse_other_length(node, vectors, role, file)
        return _table(vectors, node, step, file)

    head = _table({n: v[:5000] for n, v in vectors.items()}, node, step, file)
    return Part(name, head, names_of(head), whole)


def _of_one_length(node: _Node) -> dict[str, NDArray[Any]]:
    """The vectors of the most frequent length, that of PV first."""
    of_pv = [v.size for n, v in node.vectors.items() if role_of(n) == "process_value"]
    length = of_pv[0] if of_pv else Counter(v.size for v in node.vectors.values()).most_common(1)[0][0]
    return {n: v for n, v in node.vectors.items() if v.size == length}


def _refuse_other_length(node: _Node, vectors: dict[str, NDArray[Any]], role: str, file: str) -> None:
    left = [n for n, v in node.vectors.items() if role_of(n) == role and n not in vectors]
    if left and not any(role_of(n) == role for n in vectors):
        length = len(next(iter(vectors.values())))
        raise DataError(f"{file}: {left[0]} has {node.vectors[left[0]].size:,} values and the other vectors "
                        f"{length:,}", "save vectors of one length")


def _table(vectors: dict[str, NDArray[Any]], node: _Node, step: float | None, file: str) -> Table:
    """Table of the vectors: a time column from the step where none is there, a setpoint that is one number in full."""
    columns: dict[str, Any] = {}
    length = len(next(iter(vectors.values())))
    times = [n for n in vectors if role_of(n) == "time"]
    assumptions: list[str] = []
    if times and step is not None and not np.all(np.diff(np.asarray(vectors[times[0]], np.float64)) > 0):
        assumptions.append(f"stamps by the step of {step:g} s that the file states, because {times[0]!r} does not "
                           "always rise (--time)")
        vectors = {n: v for n, v in vectors.items() if n != times[0]}
        times = []
    if not times and step is not None:
        columns["time_s"] = numbers(np.round(np.arange(length) * step, 9))
    for name, values in vectors.items():
        plain = np.asarray(values, np.float64)
        if name in times and DATENUM[0] < float(np.nanmedian(plain)) < DATENUM[1]:
            columns[name] = timestamps(np.rint((plain - DATENUM_EPOCH) * 86_400e3).astype(np.int64) * 1_000_000)
        else:
            columns[name] = numbers(plain)
    if "setpoint" not in {role_of(n) for n in columns}:
        columns |= {name: numbers(np.full(length, value)) for name, value in node.scalars.items()
                    if role_of(name) == "setpoint" and np.isfinite(value)}
    made = table_from_arrow(pa.table(columns), file)
    return replace(made, assumptions=tuple(assumptions),
                   attributes=made.attributes | {n: w[:_MOST_SHOWN] for n, w in node.words.items()})
