"""Compare a model with a measurement: how large the error is, where it fails, and which effects that points to.

One question is one function in `questions`; each gives a table of numbers and, where the model fails, one finding.
"""

from .compare import Comparison, compare

__all__ = ["Comparison", "compare"]
