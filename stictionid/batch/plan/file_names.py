"""File names for loops: whatever a tag is called, its study stays inside the folder and its file name is unique."""

from __future__ import annotations

import hashlib
import re

_LONGEST = 80
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?\Z", re.IGNORECASE)


def key_for(loop: str) -> str:
    """A file name without ending for a loop: its own name where that is harmless, else a harmless form with a mark.

    The mark is a fingerprint of the whole name: two names never share a file, and the same name always gets the same
    one. Lower-case letters are marked too, since some file systems take them for capitals.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", loop)[:_LONGEST].strip("._- ") or "loop"
    if plain == loop and loop.upper() == loop and not _DEVICES.match(loop):
        return plain
    return f"{plain}-{hashlib.sha256(loop.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
