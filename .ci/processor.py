"""Runs tests as on another processor, with the Python that runs this: those of printed text, or those that are named.

Run: .venv/bin/python .ci/processor.py [arguments of pytest]
.ci/elsewhere.py runs it with the oldest dependencies. The machine lends itself a smaller processor: BLAS takes the
kernels of an older one, numpy none but its plainest vector loops, numba the instructions that every processor of this
kind has. Sums then round otherwise, searches go other ways, and what a test asserts of them is seen. Numba keeps
machine code by processor, so that none is mixed up or made twice.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Cores of which OpenBLAS has kernels, by machine; the first is the smallest.
_CORES = {"x86_64": ("Nehalem", "Haswell"), "amd64": ("Nehalem", "Haswell"), "aarch64": ("ARMV8", "NEOVERSEN1"),
          "arm64": ("ARMV8", "NEOVERSEN1")}
_ASK = """
import json, numpy, threadpoolctl
from numba.core.registry import cpu_target
blas = sorted({str(x.get("architecture")) for x in threadpoolctl.threadpool_info() if x["user_api"] == "blas"})
simd = numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
# (to an old compiler a new processor is generic, too, but with instructions beyond the plain ones)
_, name, features = cpu_target.target_context.codegen().magic_tuple()
print(json.dumps({"BLAS": blas, "numpy": simd, "numba": f"{name} with {features.count('+')} features"}))
"""


def asked(changes: dict[str, str]) -> dict[str, object]:
    """Kernels of BLAS, vector instructions of numpy and processor of numba that a process with these variables has."""
    done = subprocess.run([sys.executable, "-c", _ASK], env=os.environ | changes, capture_output=True, text=True,
                          check=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


def printed() -> list[str]:
    """The files with tests of printed text: to collect all tests takes as long as to run these."""
    return [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").glob("test_*.py"))
            if "pytest.mark.printed" in path.read_text(encoding="utf-8")]


def main() -> int:
    """Choose what differs from this machine, say it in a line, and run the tests; 1 where nothing differs."""
    here = asked({})
    changes = {"NUMBA_CPU_NAME": "generic", "NPY_DISABLE_CPU_FEATURES": " ".join(here["numpy"])}  # type: ignore[arg-type]
    for core in _CORES.get(platform.machine().lower(), ()):
        if asked(changes | {"OPENBLAS_CORETYPE": core})["BLAS"] != here["BLAS"]:
            changes["OPENBLAS_CORETYPE"] = core
            break
    there = asked(changes)
    print("+ as on another processor: " + ", ".join(
        f"{name} {there[name] or 'plain'} instead of {here[name]}" if there[name] != here[name]
        else f"{name} the same, {here[name]}" for name in here), flush=True)
    if there["numba"] == here["numba"]:
        return 1
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *(sys.argv[1:] or ["-m", "printed", *printed()])]
    return subprocess.run(words, env=os.environ | changes | {"STICTIONID_PAGES": "1"}, cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
