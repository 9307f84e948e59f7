"""NumPy and its linear algebra take the same instructions on every processor that has them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import generator
from generator.instruction_set import (
    NUMPY_FEATURE,
    NUMPY_VARIABLES,
    OPENBLAS_KERNELS,
    OPENBLAS_VARIABLE,
    UNSETTLED_VARIABLE,
    settle,
)

AVX2 = "flags\t\t: fpu sse4_2 abm avx2 bmi1 bmi2 f16c fma movbe\n"
AVX512 = "flags\t\t: fpu sse4_2 abm avx2 bmi1 bmi2 f16c fma movbe avx512f avx512cd avx512bw avx512dq avx512vl\n"

REPORT = """
import {first}
import numpy as np
from threadpoolctl import threadpool_info
found = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
print(*found, *sorted({{each["architecture"] for each in threadpool_info() if each["internal_api"] == "openblas"}}))
"""

WORKERS = """
import multiprocessing
{first}

def found(_):
    import numpy as np
    return np.show_config(mode="dicts")["SIMD Extensions"]["found"]

if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        theirs = pool.map(found, [0])
    print(theirs == [found(0)])
"""


@pytest.fixture
def no_numpy(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "numpy", raising=False)


def described(folder: Path, text: str) -> Path:
    path = folder / "cpuinfo"
    path.write_text("processor\t: 0\n" + text)
    return path


@pytest.mark.parametrize("flags", [AVX2, AVX512])
def test_avx2_is_taken_on_processors_that_have_it_and_more(no_numpy, tmp_path, flags) -> None:
    environment: dict[str, str] = {}
    assert settle(environment, described(tmp_path, flags))
    assert environment == {OPENBLAS_VARIABLE: OPENBLAS_KERNELS, NUMPY_VARIABLES[0]: NUMPY_FEATURE}


@pytest.mark.parametrize("flags", ["flags\t\t: fpu sse4_2 avx\n", "Features\t: fp asimd\n", ""])
def test_older_and_other_processors_compute_with_what_they_have(no_numpy, tmp_path, flags) -> None:
    environment: dict[str, str] = {}
    assert not settle(environment, described(tmp_path, flags))
    assert not settle(environment, tmp_path / "nowhere")
    assert environment == {}


def test_what_the_user_has_set_stays(no_numpy, tmp_path) -> None:
    mine = {OPENBLAS_VARIABLE: "SkylakeX", NUMPY_VARIABLES[1]: "X86_V4"}
    environment = dict(mine)
    assert settle(environment, described(tmp_path, AVX512))
    assert environment == mine


def test_after_numpy_nothing_is_changed_but_what_workers_are_told(monkeypatch, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "numpy", np)
    environment: dict[str, str] = {}
    assert not settle(environment, described(tmp_path, AVX512))
    assert environment == {UNSETTLED_VARIABLE: "1"}


def run(program: str, folder: Path, environment: dict[str, str]) -> str:
    path = folder / "program.py"
    path.write_text(program)
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, check=True, env=environment)
    return done.stdout.strip()


@pytest.fixture
def plain_environment(monkeypatch) -> dict[str, str]:
    """The environment of a shell in which nobody has thought of instructions."""
    settled = {OPENBLAS_VARIABLE, UNSETTLED_VARIABLE, *NUMPY_VARIABLES}
    return {name: value for name, value in os.environ.items() if name not in settled}


@pytest.mark.parametrize("first", ["generator", "benchmark.frames.opening", "benchmark.run.engine"])
def test_a_process_that_imports_it_first_takes_them(no_numpy, tmp_path, plain_environment, first) -> None:
    if not settle({}):
        pytest.skip("this processor has no AVX2, or does not say so")
    assert run(REPORT.format(first=first), tmp_path, plain_environment).split() == [NUMPY_FEATURE, OPENBLAS_KERNELS]


@pytest.mark.parametrize("first", ["import generator", "import numpy\nimport generator"])
def test_workers_compute_as_the_process_that_starts_them(tmp_path, plain_environment, first) -> None:
    assert run(WORKERS.format(first=first), tmp_path, plain_environment) == "True"


def test_kernels_take_no_approximate_instructions() -> None:
    """`rsqrt`, and `normalize` by it, is what each maker of processors thinks near enough; maps are baked once, anywhere."""
    folder = Path(generator.__file__).parent
    programs = [path for path in folder.rglob("*.py") if path.relative_to(folder).parts[0] != "bake"]
    taken = [
        path for path in programs if re.search(r"\b(dr|mi)\.(rsqrt|normalize)\b", path.read_text(encoding="utf-8"))
    ]
    assert len(programs) > 200
    assert taken == []
