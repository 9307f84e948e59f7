"""All solvers' answers to the same frames in one table: what comes back is what went in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from benchmark.errors import ResultsError
from benchmark.run.packed import PackedRow, pack, read_packed

N = 40
DIGITS = {"error_km": 18} | dict.fromkeys(
    ("error_east_km", "error_north_km", "cov_ee_km2", "cov_en_km2", "cov_nn_km2", "time_ms"), 16
)


def frames(seed: int, n: int = N) -> pd.DataFrame:
    """A table of frames; circumstances depend on the frame alone, answers on the seed too."""
    rng, place = np.random.default_rng(seed), np.random.default_rng(1)
    fix = rng.uniform(size=N) < 0.7
    error = np.where(fix, 10.0 ** rng.uniform(-2.0, 3.0, N), np.nan)
    table = pd.DataFrame(
        {
            "frame_id": [f"frame-{i:05d}" for i in range(N)],
            "index": np.arange(N),
            "bortle": 4,
            "condition": np.repeat([0.5, 1.0], N // 2),
            "site": [f"site {i // 3}" for i in range(N)],
            "cloud_optical_depth": place.uniform(size=N),
            "moon_illuminated": None,
            "image_sha256": [f"{i:064x}" for i in range(N)],
            "truth_sha256": [None if i == 3 else f"{7 * i:064x}" for i in range(N)],
            "status": np.where(fix, "fix", "refused"),
            "reason": np.where(fix, "", "too few stars"),
            "lat_deg": np.where(fix, 51.0, np.nan),
            "error_km": error,
            "error_east_km": 0.6 * error,
            "error_north_km": 0.8 * error,
            "cov_ee_km2": error**2,
            "cov_en_km2": 0.1 * error**2,
            "cov_nn_km2": error**2,
            "confidence": np.where(fix, 1.0 - 10.0 ** rng.uniform(-14.0, -1.0, N), np.nan),
            "n_detections": rng.integers(10, 50, N),
            "n_detected_stars": rng.integers(5, 10, N),
            "n_matches": np.where(fix, 5, 0),
            "n_correct": np.where(fix, 4, 0),
            "time_ms": rng.uniform(1.0, 900.0, N),
            "crlb_km": place.uniform(size=N),
            "peak_memory_mib": 233.5,
        }
    )
    return table.iloc[:n].reset_index(drop=True)


def rows() -> list[PackedRow]:
    return [
        PackedRow("skybench", "own", "a" * 12, {"date_utc": "2026-11-22T00:00:00Z"}, frames(2)),
        PackedRow("tetra3rs", "own", "b" * 12, {"jobs": 2}, frames(3)),
        PackedRow("skybench", "shared", "c" * 12, {}, frames(4, N // 2)),
    ]


def stored(folder: Path, packed: list[PackedRow]) -> Path:
    table, listing = pack(packed)
    (folder / "dev.parquet").write_bytes(table)
    (folder / "dev.json").write_bytes(listing)
    return folder / "dev.json"


def test_what_is_packed_comes_back_to_its_digits(tmp_path: Path) -> None:
    back = read_packed(stored(tmp_path, rows()))
    assert [(one.solver, one.detections, one.key, one.provenance) for one in back] == [
        (one.solver, one.detections, one.key, one.provenance) for one in rows()
    ]
    for before, after in zip(rows(), back, strict=True):
        assert len(after.frames) == len(before.frames)
        for name in after.frames.columns:
            was, found = before.frames[name], after.frames[name]
            if was.dtype.kind == "f":
                rtol = 2.0 ** (1 - DIGITS.get(name, 24))
                np.testing.assert_allclose(found.to_numpy(float), was.to_numpy(float), rtol=rtol)
            else:
                assert (found.isna() == was.isna()).all(), name
                assert (found.dropna() == was.dropna()).all(), name


def test_circumstances_are_stored_once_and_answers_in_a_list(tmp_path: Path) -> None:
    table = pq.read_table(stored(tmp_path, rows()).with_suffix(".parquet"))
    assert table.num_rows == N
    answers = table.to_pandas()["answers"]
    assert answers.map(len).eq(3).all()
    assert [one is None for one in answers.iloc[-1]] == [False, False, True]


def test_the_order_of_confidences_near_one_survives(tmp_path: Path) -> None:
    back = read_packed(stored(tmp_path, rows()))
    for before, after in zip(rows(), back, strict=True):
        assert (after.frames["confidence"].rank() == before.frames["confidence"].rank()).sum() == (
            before.frames["confidence"].notna().sum()
        )


def test_no_error_comes_to_lie_on_the_other_side_of_a_limit(tmp_path: Path) -> None:
    given = frames(2)
    limits = np.resize([1.0, 3.0, 10.0, 30.0], N)
    errors = np.where(np.arange(N) % 8 < 4, limits, np.nextafter(limits, 0.0))
    table = given.assign(status="fix", error_km=errors)
    (back,) = read_packed(stored(tmp_path, [PackedRow("skybench", "own", "a" * 12, {}, table)]))
    assert ((back.frames["error_km"] < limits) == (errors < limits)).all()


def test_what_was_packed_packs_again_to_the_same_bytes(tmp_path: Path) -> None:
    path = stored(tmp_path, rows())
    assert pack(read_packed(path)) == (path.with_suffix(".parquet").read_bytes(), path.read_bytes())


def test_a_new_result_joins_packed_ones_of_the_same_frames(tmp_path: Path) -> None:
    old = read_packed(stored(tmp_path, rows()))
    new = PackedRow("cedar-solve", "own", "d" * 12, {}, frames(5))
    assert len(read_packed(stored(tmp_path, [*old, new]))) == 4


def test_results_on_different_frames_are_refused() -> None:
    other = frames(3)
    other.loc[3, "cloud_optical_depth"] += 1.0
    with pytest.raises(ResultsError, match=r"tetra3rs-bbbbbbbbbbbb and skybench-a+ .*their frames differ"):
        pack([rows()[0], PackedRow("tetra3rs", "own", "b" * 12, {}, other)])


def test_a_table_that_was_changed_alone_is_refused(tmp_path: Path) -> None:
    path = stored(tmp_path, rows())
    path.with_suffix(".parquet").write_bytes(pack([rows()[0]])[0])
    with pytest.raises(ResultsError, match=r"dev\.parquet: was changed after it was packed"):
        read_packed(path)


@pytest.mark.parametrize("damage", ["format", "rows", "table_sha256"])
def test_a_damaged_listing_is_refused(tmp_path: Path, damage: str) -> None:
    path = stored(tmp_path, rows())
    tree = json.loads(path.read_text())
    del tree[damage]
    path.write_text(json.dumps(tree))
    with pytest.raises(ResultsError, match="not readable packed results"):
        read_packed(path)


def test_another_format_and_another_number_of_rows_are_refused(tmp_path: Path) -> None:
    path = stored(tmp_path, rows())
    tree = json.loads(path.read_text())
    path.write_text(json.dumps(tree | {"format": "skybench-packed/9"}))
    with pytest.raises(ResultsError, match=r"this version reads 'skybench-packed/1'"):
        read_packed(path)
    path.write_text(json.dumps(tree | {"rows": tree["rows"][:2]}))
    with pytest.raises(ResultsError, match="lists of other lengths than 2"):
        read_packed(path)
