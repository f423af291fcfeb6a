"""Conversion of Arrow columns to numpy and back through their buffers; pyarrow's own way imports pandas (0.45 s).

A cast imports pyarrow.compute, which takes as long as reading a short file: a column of the right type goes without.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...typing import BoolArray, FloatArray


def floats(column: Any) -> FloatArray:
    """A number column as float64 (n,), NaN where it is null."""
    if pa.types.is_integer(column.type) and not column.null_count:
        return _values(column, np.int64).astype(np.float64)
    column = column if column.type == pa.float64() else column.cast(pa.float64(), safe=False)
    return np.asarray(_values(column.fill_null(float("nan")) if column.null_count else column, np.float64))


def integers(column: Any) -> tuple[NDArray[np.int64], BoolArray]:
    """An int64 column as numbers (n,), 0 where it is null, and True (n,) where it is not."""
    if column.null_count == 0:
        return _values(column, np.int64), np.ones(len(column), np.bool_)
    return _values(column.fill_null(0), np.int64), booleans(column.is_valid())


def booleans(column: Any) -> BoolArray:
    """A boolean column (n,), False where it is null."""
    column = column.fill_null(False) if column.null_count else column
    return np.asarray(_values(column.cast(pa.uint8()), np.uint8) != 0)


def _values(column: Any, dtype: Any) -> NDArray[Any]:
    chunks = column.chunks if hasattr(column, "chunks") else [column]
    # A length of zero has no buffer that numpy would take.
    parts = [np.from_dlpack(chunk) for chunk in chunks if len(chunk)]
    if not parts:
        return np.zeros(0, dtype)
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def texts(values: Any) -> Any:
    """A list of str as an Arrow string array."""
    encoded = [str(v).encode() for v in values]
    offsets = np.concatenate([[0], np.cumsum([len(v) for v in encoded])]).astype(np.int32)
    return pa.Array.from_buffers(
        pa.string(), len(encoded), [None, pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))]
    )


def timestamps(ns: NDArray[np.int64]) -> Any:
    """Nanoseconds since the epoch as an Arrow time stamp array without zone."""
    return pa.Array.from_buffers(pa.timestamp("ns"), len(ns), [None, pa.py_buffer(np.ascontiguousarray(ns))])


def coded(column: Any, missing: int | None = None) -> tuple[list[Any], NDArray[np.int64]]:
    """Different values of a column, and for each row (n,) the place of its own among them.

    A null has the place `missing`, by default the one behind the last value.
    """
    encoded = column.dictionary_encode()
    encoded = encoded.combine_chunks() if isinstance(encoded, pa.ChunkedArray) else encoded
    values = encoded.dictionary.to_pylist()
    codes, valid = integers(encoded.indices.cast(pa.int64()))
    return values, np.where(valid, codes, len(values) if missing is None else missing)


def numbers(values: NDArray[Any]) -> Any:
    """An int64 or float64 array as an Arrow array."""
    kind = pa.float64() if values.dtype == np.float64 else pa.int64()
    wide = np.ascontiguousarray(values, np.float64 if kind == pa.float64() else np.int64)
    return pa.Array.from_buffers(kind, len(wide), [None, pa.py_buffer(wide)])


def whole(column: Any) -> Any:
    """A column as one array of its values, without dictionary and chunks."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    return column
