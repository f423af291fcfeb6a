"""Machine code of kernels: read from disk without numba's compiler, and compiled by several processes at once.

The kernels that sample loops ask for are in benchmarks/long.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import HANGS_S

from stictionid.historian import read
from stictionid.numerics.machine_code import ahead
from stictionid.numerics.machine_code.needed import NEEDED, PLAIN
from stictionid.numerics.machine_code.turn import Turn
from stictionid.paths import likelihood
from stictionid.verbs.identify import identify

ROOT = Path(__file__).parent.parent
KERNELS = """
import numpy as np
from stictionid.numerics.jit import kernel

@kernel
def part(x, scale):
    out = np.zeros(len(x))
    for i in range(len(x)):
        out[i] = scale * x[i]
    return out

@kernel
def whole(x, scale):
    return part(x, scale).sum() + len(x)
"""
ASKS = """
import sys
import numpy as np
from kernels import part, whole
print(sum(part(np.arange(5.0), 2.0)), {more}, "numba.np.arraymath" in sys.modules, sum(part.stats.cache_hits.values()))
"""


def answer(folder: Path, more: str = "0") -> list[str]:
    env = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run([sys.executable, "-c", ASKS.format(more=more)], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("kernels")
    (place / "kernels.py").write_text(KERNELS)
    assert answer(place) == ["20.0", "0", "True", "0"]
    return place


def test_a_kernel_on_disk_loads_without_the_compiler(folder: Path) -> None:
    assert answer(folder) == ["20.0", "0", "False", "1"]


def test_a_kernel_compiled_later_calls_one_that_was_loaded(folder: Path) -> None:
    assert answer(folder, "whole(np.arange(5.0), 3.0)") == ["20.0", "35.0", "True", "1"]
    # Both are on disk now, the caller with its callee inside.
    assert answer(folder, "whole(np.arange(5.0), 3.0)") == ["20.0", "35.0", "False", "1"]


def test_a_process_waits_for_the_one_that_compiles(tmp_path: Path) -> None:
    mine, other, place = Turn(), Turn(), str(tmp_path / "k")
    mine.take(place)
    assert other.taken(place)
    code = "from stictionid.numerics.machine_code.turn import Turn; t = Turn(); " \
           f"print(t.taken({place!r}), flush=True); t.take({place!r}); print('got it')"
    waiting = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert waiting.stdout is not None and waiting.stdout.readline() == "True\n" and waiting.poll() is None
    mine.give()
    assert waiting.communicate(timeout=HANGS_S)[0] == "got it\n" and not other.taken(place)


def test_the_list_names_kernels_that_are_there() -> None:
    found = [ahead.name_of(kernel.py_func, signature) for kernel, signature in ahead.kernels()]
    assert found == list(NEEDED) and len(found) > 20
    assert list(ahead.kernels(("stictionid.numerics.varpro.gone d1C",))) == []


@pytest.mark.parametrize(("line", "plain"), [(0, True), (PLAIN - 1, True), (PLAIN, False), (len(NEEDED) - 1, False)])
def test_a_first_run_is_said_for_kernels_of_a_plain_record(line: int, plain: bool,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    (kernel, signature), = ahead.kernels(NEEDED[line:line + 1])
    heard: list[bool] = []
    monkeypatch.setattr(ahead, "listeners", [heard.append])
    monkeypatch.setenv(ahead.ALONE, "1")
    ahead.begin(kernel.py_func, signature)
    assert heard == [plain]


def test_code_of_a_changed_source_is_compiled_again(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(KERNELS)
    assert answer(tmp_path)[-1] == "0"
    (tmp_path / "kernels.py").write_text(KERNELS.replace("scale * x[i]", "scale + x[i] + 0"))
    assert answer(tmp_path) == ["20.0", "0", "True", "0"]
    assert answer(tmp_path, "part(np.arange(2.0), 7.0)[0]")[1] == "7.0"


def test_a_share_of_the_list_is_compiled_once(tmp_path: Path) -> None:
    code = "from stictionid.numerics.machine_code import ahead; " \
           "few = tuple(n for n in ahead.NEEDED if '._decay ' in n or 'contract._fill ' in n); ahead.NEEDED = few; " \
           "print(len(few), [ahead.compile_share(i, 2, lambda: True) for i in (0, 1, 1)], " \
           "ahead.compile_share(0, 1, lambda: False))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, cwd=ROOT)
    assert done.stdout == "2 [1, 1, 0] 0\n", done.stderr
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


@pytest.mark.parametrize(("before", "helpers"), [("", 2), ("os.environ[ahead.ALONE] = '1'", 0)])
def test_helpers_start_with_the_first_absent_kernel_and_end_with_the_command(before: str, helpers: int,
                                                                            tmp_path: Path) -> None:
    code = f"""
import os
from stictionid.numerics.machine_code import ahead
import subprocess
from stictionid.numerics.machine_code import ahead
from stictionid.process.linear import transient
import numpy as np
os.sched_getaffinity = lambda process: {{0, 1, 2}}
started, begin = [], subprocess.Popen
subprocess.Popen = lambda *given, **more: started.append(begin(*given, **more)) or started[-1]
{before}
transient(np.ones(3), np.ones((3, 3)), step_s=1.0)
print(*(helper.pid for helper in started))
"""
    env = {k: v for k, v in os.environ.items() if k != ahead.ALONE}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT,
                          env={**env, "NUMBA_CACHE_DIR": str(tmp_path)})
    pids = [int(word) for word in done.stdout.split()]
    assert len(pids) == helpers, done.stderr
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_plain_record_calls_no_kernel_that_seeks_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """The beam takes a third of all compiling: the first command waits for it no longer."""
    called: list[object] = []
    monkeypatch.setattr(likelihood, "beam", lambda *given: called.append(given))
    study = identify(read(str(ROOT / "sample_data" / "foptd_scanned.parquet")).loop)
    assert study.verdict.stiction == "stiction" and study.steps[-1].effects == () and called == []
