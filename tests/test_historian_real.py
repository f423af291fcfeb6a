"""The real plant records and the loops with a hidden effect read as their README says, without any option."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from stictionid.historian import read

SHARED = Path(__file__).resolve().parents[2] / "shared"
REAL, HIDDEN = SHARED / "real_loops", SHARED / "hidden_effects"
pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="the shared records are not here")

# file → rows in the file, samples, step, setpoint, columns of PV and OP, findings that must be there
FILES = {
    "loop_A.csv": (1625, 1625, 1.0, False, "PV", "OP", set()),
    "loop_B.csv": (1000, 1000, 1.0, False, "PV", "OP", {"output-not-percent"}),
    "loop_C.csv": (1196, 1196, 1.0, False, "PV", "OP", set()),
    "loop_D.csv": (1196, 1196, 1.0, False, "PV", "OP", set()),
    "loop_E.csv": (1500, 1500, 20.0, False, "PV", "OP", {"output-not-percent"}),
    # 93 of its rows have OP and no PV: the valve runs through them.
    "export_F.csv": (10080, 10080, 60.0, False, "FT_211", "FV_211", {"newest-first", "process-value-missing"}),
    "export_G.txt": (751, 751, 10.0, True, "2411FIC20102.PV", "2411FIC20102.MV", set()),
    "export_H.txt": (751, 751, 10.0, True, "2411FIC20102.PV", "2411FIC20102.MV", set()),
    "export_I.txt": (
        751,
        751,
        10.0,
        True,
        "LYCDU.RHT.7050-342_FIC10112.PV",
        "LYCDU.RHT.7050-342_FIC10112.MV",
        {"dead-signal", "duplicate-stamps"},
    ),
    "export_J.txt": (751, 751, 10.0, True, "2111FIC40102B.PV", "2111FIC40102B.MV", set()),
    "export_K.txt": (751, 751, 10.0, True, "2111PIC10201.PV", "2111PIC10201.MV", {"output-not-percent"}),
    "export_L.txt": (751, 751, 10.0, True, "2111FIC10201.PV", "2111FIC10201.MV", set()),
    "export_M.txt": (126, 126, 60.0, True, "LYCDU.CDU.7040-312_LIC63001.PV", "LYCDU.CDU.7040-312_LIC63001.MV", set()),
}


@pytest.mark.parametrize("name", FILES)
def test_real_exports(name):
    rows, samples, step, has_setpoint, pv, op, codes = FILES[name]
    reading = read(REAL / name)
    loop = reading.loop
    assert reading.rows["in"] == rows == sum(v for k, v in reading.rows.items() if k != "in")
    assert (loop.samples, loop.step_s, loop.setpoint is not None) == (samples, step, has_setpoint)
    assert (reading.columns["process_value"], reading.columns["output"]) == (pv, op)
    assert codes <= {f.code for f in reading.findings}
    assert (loop.units["output"] == "%") == ("output-not-percent" not in codes)
    assert loop.origin.sha256 == hashlib.sha256((REAL / name).read_bytes()).hexdigest()


def test_newest_first_export_is_turned_round():
    loop = read(REAL / "export_F.csv").loop
    assert loop.origin.start == "2024-11-21T00:00:00"
    assert loop.process_value[0] == 76.0531539916992
    assert loop.process_value[-1] == 102.890357971191


@pytest.mark.parametrize("number", range(1, 11))
def test_loops_with_a_hidden_effect(number):
    path = HIDDEN / f"hidden_{number:02d}.csv"
    reading = read(path)
    table = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(1, 2, 3, 4))
    loop = reading.loop
    for column, values in enumerate((loop.setpoint, loop.process_value, loop.output, loop.position)):
        np.testing.assert_array_equal(values, table[:, column])
    assert loop.used.all() and loop.step_s == 1.0 and loop.units["output"] == "%"
    assert reading.assumptions == ()
    assert not [f for f in reading.findings if f.severity != "info"]
