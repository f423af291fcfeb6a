"""Long tests: matrices and single hard loops, of which tests/ holds a sample. Run: python -m pytest benchmarks/long"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2] / "tests"
sys.path.insert(0, str(TESTS))
runpy.run_path(str(TESTS / "conftest.py"))
