"""The stiction laws, one file each; the catalogue finds them by looking at the folder."""

from __future__ import annotations

from ..system.registry import room
from .contract import Law

DEFAULT = "chen"

# All laws by name, the default first, then by name; and one of them.
catalogue, get = room(__name__, "LAW", Law, "law", lambda law: (law.name != DEFAULT, law.name))
