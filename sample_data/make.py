"""Makes the files of sample_data again, byte for byte: python sample_data/make.py [FOLDER]."""

from __future__ import annotations

import sys
from pathlib import Path

from stictionid.model.closed_loop import Setting, preset, simulate, with_stiction
from stictionid.record.study import to_json
from stictionid.record.write import write_loop
from stictionid.system.files import write_whole


def loops() -> dict[str, tuple[Setting, int]]:
    """File name to setting and seed."""
    from dataclasses import replace

    foptd, itptd, tank = preset("foptd"), preset("itptd"), preset("tank")
    scanned = replace(foptd, controller=replace(foptd.controller, scan_s=1.0), noise_sd=0.05,
                      setpoint_moves=((0.0, 5.0), (400.0, -8.0), (700.0, 6.0)))
    return {
        "foptd.csv": (replace(with_stiction(foptd, 5.0, 3.0), noise_sd=0.05), 1),
        "foptd_scanned.parquet": (with_stiction(scanned, 4.0, 2.0), 2),
        "itptd.parquet": (with_stiction(itptd, 5.0, 3.5), 3),
        "tank.csv": (replace(tank, noise_sd=0.015, step_s=5.0, controller=replace(tank.controller, scan_s=5.0)), 4),
        "healthy.csv": (replace(with_stiction(scanned, 0.0, 0.0), noise_sd=0.1,
                                setpoint_moves=tuple((100.0 * k, (-1) ** k * 4.0) for k in range(10))), 5),
    }


def make(folder: Path) -> list[Path]:
    """Write every loop and its truth into `folder`; returns the files."""
    written = []
    for name, (setting, seed) in loops().items():
        result = simulate(setting, seed=seed)
        data, truth = folder / name, (folder / name).with_suffix(".truth.json")
        write_loop(result.loop, data, force=True)
        write_whole(truth, to_json(result.truth), force=True)
        written += [data, truth]
    return written


if __name__ == "__main__":
    for path in make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent):
        print(path)
