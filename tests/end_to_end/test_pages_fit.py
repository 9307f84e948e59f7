"""The committed pages on a screen and on a telephone: what fits has no scroll bar, and what matters is in sight."""

from pathlib import Path

import pytest
from browser import chromium, console, open_page, requested

RESULTS = Path(__file__).parents[2] / "results"
SITE = RESULTS / "leaderboard" / "site"
PAGES = {
    "index": SITE / "index.html",
    "task": SITE / "bortle@2-dev-own.html",
    "failures": SITE / "bortle@2-dev-own-failures.html",
    "solver": SITE / "solver-skybench.html",
    "calibration": RESULTS / "studies" / "calibration" / "index.html",
    "thesis": RESULTS / "studies" / "thesis" / "index.html",
    "independence": RESULTS / "studies" / "independence" / "index.html",
    "realism": RESULTS / "studies" / "realism" / "index.html",
    "realism-meteor": RESULTS / "studies" / "realism-meteor" / "index.html",
}
SCREEN_PX, PHONE_PX = 1300, 400
TITLES = {
    "index": "skybench leaderboard",
    "task": "bortle@2",
    "failures": "Failures of all solvers on bortle@2",
    "solver": "skybench leaderboard",
    "calibration": "Effects of calibration errors",
    "thesis": "replicated: skybench study",
    "independence": "What generator and solvers share",
    "realism": "Photographs and their twins",
    "realism-meteor": "Photographs and their twins",
}
# Tables by what they show; those with a column for each of many values may be wider than a telephone.
SCROLLING = """
return [...document.querySelectorAll(".scroll, pre")].filter((one) => one.scrollWidth > one.clientWidth)
  .map((one) => `${one.ariaLabel}: ${one.scrollWidth} in ${one.clientWidth}`);
"""
# Words that leave their drawing, by the boxes that the browser has laid out.
CLIPPED = """
const out = [];
for (const drawing of document.querySelectorAll("svg.panel:not(.store)")) {
  const free = getComputedStyle(drawing).overflow === "visible";
  const frame = (free ? document.body : drawing).getBoundingClientRect();
  for (const words of drawing.querySelectorAll("text")) {
    const box = words.getBoundingClientRect();
    if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1 || box.bottom > frame.bottom + 1)
      out.push(`${drawing.getAttribute("aria-label")}: ${words.textContent}`);
  }
}
return out;
"""
SMALLEST_PX = """
return Math.min(12, ...[...document.querySelectorAll("svg.panel:not(.store)")].map((one) =>
  12 * one.getBoundingClientRect().width / one.viewBox.baseVal.width));
"""
EMPTY = "return [...document.querySelectorAll('dd, dt')].filter((one) => !one.textContent.trim()).length"
SHARED = ("site.css", "site.js")


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_screen_and_telephone(driver, name):
    for width, dark in ((SCREEN_PX, False), (PHONE_PX, True)):
        open_page(driver, PAGES[name], width, dark)
        driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; });")
        assert TITLES[name] in driver.title
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        if width == SCREEN_PX:
            assert driver.execute_script(SCROLLING) == []
        assert driver.execute_script(CLIPPED) == []
        assert driver.execute_script(SMALLEST_PX) > 10.0
        assert driver.execute_script(EMPTY) == 0
        assert console(driver) == []
        # A browser that has just started may ask itself for its first page.
        assert {url.split(":")[0] for url in requested(driver)} <= {"file", "data", "chrome", "chrome-untrusted"}


@pytest.mark.parametrize(
    ("name", "table"),
    [("index", "all-results"), ("task", "results"), ("solver", "results"), ("failures", "failure-list")],
)
def test_the_columns_that_matter_are_in_sight_on_a_telephone(driver, name, table):
    open_page(driver, PAGES[name], PHONE_PX)
    wanted = ["solver", "what happened"] if name == "failures" else ["success", "error / bound"]
    cells = driver.execute_script(
        "const table = document.getElementById(arguments[0]);"
        "const row = table.tBodies[0].rows[0];"
        "return [...table.tHead.rows[0].cells].map((cell, n) =>"
        "  [cell.textContent, cell.getBoundingClientRect().width, row.cells[n].getBoundingClientRect().right]);",
        table,
    )
    shown = [(words, right) for words, width, right in cells if width > 0]
    for want in wanted:
        (right,) = [right for words, right in shown if words.startswith(want)]
        assert right <= PHONE_PX, want


def test_style_and_scripts_stand_once_beside_the_pages():
    for page in SITE.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "<style" not in text
        assert all(f'"{name}"' in text for name in SHARED)
    assert all((SITE / name).stat().st_size > 1000 for name in (*SHARED, "failures.js"))
