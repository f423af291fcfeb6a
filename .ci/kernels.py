"""Lends the checkout the kernels that the package installed from it has compiled.

Run: .venv/bin/python .ci/kernels.py
Numba keeps machine code beside its source, and knows a source by size and time. Where the installed source has the
same bytes, the code is copied, and the source in the checkout gets the time of the installed one. Only Python's own
library is used here.
"""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def lend(installed: Path, checkout: Path) -> int:
    """Copy the machine code of every source that is the same in both folders; the number of files copied."""
    copied = 0
    for source in installed.rglob("*.py"):
        own = checkout / source.relative_to(installed)
        codes = sorted((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ci]"))
        if not codes or not own.is_file() or own.read_bytes() != source.read_bytes():
            continue
        times = source.stat()
        os.utime(own, ns=(times.st_atime_ns, times.st_mtime_ns))
        place = own.parent / "__pycache__"
        place.mkdir(exist_ok=True)
        for code in codes:
            shutil.copy2(code, place)
        copied += len(codes)
    return copied


if __name__ == "__main__":
    count = lend(Path(sysconfig.get_path("purelib")) / "stictionid", ROOT / "stictionid")
    print(f"+ {count} files of machine code lent to the checkout")
    sys.exit(0)
