"""Catalogue of the stiction laws, one file each; a new law is a new file in this folder."""

from __future__ import annotations

from ..system.registry import room
from .contract import Law

DEFAULT = "chen"

# `catalogue()` gives all laws by name, the default first, then in the order of names; `get(name)` gives one.
catalogue, get = room(__name__, "LAW", Law, "law", lambda law: (law.name != DEFAULT, law.name))
