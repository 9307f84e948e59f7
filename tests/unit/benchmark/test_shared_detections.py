"""The name of the detector that all solvers may share."""

import ast
from pathlib import Path

import celnav
from benchmark.run.shared_detections import DETECTOR_CODE


def test_the_digest_covers_all_that_detection_is_made_of():
    """Every module of celnav that one of them imports is one of them; errors decide nothing."""
    package = Path(celnav.__file__).parent
    trees = [ast.parse((package / f"{module}.py").read_text(encoding="utf-8")) for module in DETECTOR_CODE]
    imported = {
        str(node.module).removeprefix("celnav.")
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("celnav.")
    }
    assert imported - {"errors"} <= set(DETECTOR_CODE)
