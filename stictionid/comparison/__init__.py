"""Comparison of a model with a measurement: size of the error, parts of the record where it fails, likely effects.

Each question is one function in `questions`. It gives a table of numbers and, where the model fails, one finding.
"""

from .compare import Comparison, compare

__all__ = ["Comparison", "compare"]
