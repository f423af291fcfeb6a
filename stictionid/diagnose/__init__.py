"""Which physical effect is missing: refit the model with each one, rank them, accept what clearly helps, and repeat."""

from .run import diagnose
from .steps import add, variants

__all__ = ["add", "diagnose", "variants"]
