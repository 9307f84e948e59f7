"""Make docs/task_cards.md: python tools/build_task_cards.py."""

from __future__ import annotations

from pathlib import Path

from benchmark.tasks.card import card, limits
from benchmark.tasks.definition import load_task, task_names

OUT = Path(__file__).parents[1] / "docs" / "task_cards.md"


def page() -> str:
    """All cards on one page."""
    cards = "\n".join(card(load_task(name)) for name in task_names())
    return f"""# Task cards

This page has one card for each task, generated from its files by `tools/build_task_cards.py`. [tasks.md](tasks.md) explains
how tasks are run, graded and frozen. Metrics and statistics are in [benchmark.md](benchmark.md), and results in
[results/leaderboard](../results/leaderboard/README.md).

Limits of all tasks:

{limits()}
{cards}"""


if __name__ == "__main__":
    OUT.write_text(page(), encoding="utf-8")
