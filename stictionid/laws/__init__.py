"""Catalogue of the stiction laws, one file each, and of those that users write; a new law is a new file.

User-written laws come from `use` (files that a command line names), from the environment variable STICTIONID_LAWS, from
installed packages with the entry point `stictionid.laws`, and from `register`.
"""

from __future__ import annotations

from ..system.open_room import OpenRoom
from .contract import Law

DEFAULT = "chen"
# Files and folders with laws, separated as in PATH; the group of entry points by which packages bring laws.
VARIABLE, GROUP = "STICTIONID_LAWS", "stictionid.laws"

# `catalogue()` gives all laws by name, the default first, then in the order of names; `get(name)` gives one. The others
# add laws and take them out again, as those of the effects do.
_room = OpenRoom(__name__, "LAW", Law, "law", lambda law: (law.name != DEFAULT, law.name), variable=VARIABLE,
                 group=GROUP)
catalogue, get, register, forget, added, use = (_room.catalogue, _room.get, _room.register, _room.forget, _room.added,
                                                _room.use)
