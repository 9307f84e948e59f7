"""Make scenes/schema.json: python tools/build_schema.py."""

from __future__ import annotations

import json
from pathlib import Path

from generator.scenario.schema import scenario_schema

OUT = Path(__file__).parents[1] / "scenes" / "schema.json"

if __name__ == "__main__":
    OUT.write_text(json.dumps(scenario_schema(), indent=1) + "\n", encoding="utf-8")
