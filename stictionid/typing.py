"""Aliases of the array types in annotations; shapes and units stand in the docstrings of the functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.signedinteger[Any]]

# Told now and then by anything that takes long: a sentence, and the share that is done (0 to 1).
Progress = Callable[[str, float], None]
