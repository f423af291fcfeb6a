"""The identification methods, one file each; the catalogue finds them by scanning the folder."""

from __future__ import annotations

from ..system.registry import room
from .contract import Method

DEFAULT = "auto"

# All methods by name, the default first, then by name; and the lookup of one by its name.
catalogue, get = room(__name__, "METHOD", Method, "method", lambda method: (method.name != DEFAULT, method.name))
