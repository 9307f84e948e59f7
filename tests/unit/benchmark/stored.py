"""Results as the report reads them, by solver."""

from pathlib import Path

import pandas as pd

from benchmark.report.site.tree import StoredResult, read_tree


def stored(root: Path) -> dict[str, StoredResult]:
    """The results of a tree in which each solver has one."""
    found = [result for group in read_tree(root) for result in group]
    assert len({result.solver for result in found}) == len(found)
    return {result.solver: result for result in found}


def detections(result: StoredResult) -> pd.DataFrame:
    return pd.read_parquet(result.folder / "matches.parquet")
