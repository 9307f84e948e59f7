"""Metadata of a deposit on Zenodo: ``.zenodo.json`` (https://developers.zenodo.org/#representation)."""

from __future__ import annotations

import html
import json
from pathlib import Path

from generator.dataset.croissant import LICENSE_URL
from generator.dataset.manifest import Manifest
from generator.files import write_bytes

ZENODO = ".zenodo.json"
CREATOR = "The skybench authors"
SOURCE = "https://github.com/skybench/skybench"
KEYWORDS = ("astronomy", "celestial navigation", "star identification", "synthetic images")


def write_zenodo(folder: Path, manifests: list[Manifest]) -> None:
    """Write the metadata of a dataset's deposit; one manifest per split.

    The creator is a placeholder that names the authors of the frames' physics; depositors of a dataset add their own names.
    """
    names = sorted({manifest.scenario for manifest in manifests})
    recipes = "; ".join(
        f"{html.escape(each.split)}: scenario {html.escape(each.scenario)}, SHA-256 {html.escape(each.scenario_sha256)}, "
        f"frames {each.first} to {each.stop - 1}"
        for each in manifests
    )
    metadata = {
        "title": f"{', '.join(names)}: synthetic night-sky frames with complete truth",
        "upload_type": "dataset",
        "description": (
            "<p>16-bit frames of the night sky with the truth about every star, rendered by skybench "
            f"{html.escape(manifests[0].skybench)}. Recipes: {recipes}. The same recipe gives the same bytes.</p>"
        ),
        "creators": [{"name": CREATOR}],
        "license": "cc-by-4.0",
        "access_right": "open",
        "version": manifests[0].skybench,
        "keywords": list(KEYWORDS),
        "related_identifiers": [{"identifier": SOURCE, "relation": "isCompiledBy", "scheme": "url"}],
        "notes": f"Licence: {LICENSE_URL}",
    }
    write_bytes(folder / ZENODO, (json.dumps(metadata, indent=2, ensure_ascii=False) + "\n").encode())
