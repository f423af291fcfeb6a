"""The kernels that `identify` asks for: writes stictionid/numerics/machine_code/needed.py.

Run: python benchmarks/kernels.py, after a kernel was added or its arguments changed. The loops of the sample data are
identified in this process, the plainest first, and each kernel's kinds of arguments are noted.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
HOME = ROOT / "stictionid" / "numerics" / "machine_code" / "needed.py"
HEAD = '''"""Kernels that `identify` asks for on common loops; written by benchmarks/kernels.py.

Those of a plain record come first, from the last one used to the first: the command itself begins with the first. Those
of further records follow in the order of use.

A line is a kernel, then a word an argument: the letter of its dtype; of an array also dimensions, layout, r: read-only.
"""

from __future__ import annotations

# Number of the kernels below that a plain record asks for.
PLAIN = {plain}
NEEDED: tuple[str, ...] = (
'''
FILES = ("foptd_scanned.parquet", "foptd.csv", "healthy.csv", "itptd.parquet")


def used(rows: int | None = None) -> tuple[list[str], int]:
    """Lines of the list: every kernel with every kind of arguments that identifying the sample loops calls it with.

    Second: how many of them are those of a plain record, which come first.
    With `rows` only so many first samples of each loop are identified.
    """
    from numba.core.dispatcher import Dispatcher

    from stictionid.historian import read
    from stictionid.numerics.machine_code import ahead
    from stictionid.verbs.identify import identify

    found: dict[str, None] = {}
    first_call = Dispatcher._compile_for_args

    def noted(self, *arguments, **more):  # type: ignore[no-untyped-def]
        found[ahead.name_of(self.py_func, [self.typeof_pyval(a) for a in arguments])] = None
        return first_call(self, *arguments, **more)

    Dispatcher._compile_for_args = noted
    plain = 0
    try:
        for name in FILES:
            loop = read(str(ROOT / "sample_data" / name)).loop
            identify(loop.cut(0, rows or loop.samples))
            found.pop("", None)
            plain = plain or len(found)
    finally:
        Dispatcher._compile_for_args = first_call
    lines = list(found)
    return lines[:plain][::-1] + lines[plain:], plain


if __name__ == "__main__":
    lines, plain = used()
    HOME.write_text(HEAD.format(plain=plain) + "".join(f'    "{line}",\n' for line in lines) + ")\n", encoding="utf-8")
    print(f"{len(lines)} kernels, {HOME.relative_to(ROOT)}")
    sys.exit(0)
