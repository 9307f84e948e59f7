"""Commands in a limited address space: they work, or say in one line that memory is lacking."""

import resource
from functools import partial

import pytest
from large_results import write_large
from tiny_dataset import start

GB = 1_000_000 * 1024


# Each starts the program and renders a frame.
@pytest.mark.journey
@pytest.mark.parametrize(("limit_gb", "status"), [(3, 0), (1, 2)])
def test_rendering(tmp_path, limit_gb, status) -> None:
    limit = partial(resource.setrlimit, resource.RLIMIT_AS, (limit_gb * GB, limit_gb * GB))
    with start("render", "00_hello", "--out", str(tmp_path / "out"), preexec_fn=limit) as process:
        _, errors = process.communicate()
    assert process.returncode == status, errors
    assert "Traceback" not in errors
    assert ("out of memory" in errors) == (status == 2)
    assert (tmp_path / "out" / "stars.parquet").exists() == (status == 0)


@pytest.mark.journey
def test_pages_of_results(tmp_path) -> None:
    write_large(tmp_path, 5, 500)
    with start(
        "bench", "report", "--out", str(tmp_path),
        preexec_fn=partial(resource.setrlimit, resource.RLIMIT_AS, (2 * GB, 2 * GB)),
    ) as process:  # fmt: skip
        _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert (tmp_path / "site" / "index.html").exists()
