"""The report over tasks in a real browser, from disk, without a network."""

import io

import numpy as np
import pytest
from browser import chromium, console, open_page, requested
from PIL import Image
from selenium.webdriver.support.ui import WebDriverWait
from unit.benchmark.fake_results import SOLVERS, TASKS, write_frames, write_results

from benchmark.report.site.commands import Places
from benchmark.report.site.pages import make_boards, write_site

PHONE_PX = 390
# A browser goes through a site of four boards; `test_pages_fit.py` opens the committed pages every day.
pytestmark = pytest.mark.journey


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    root = write_results(folder / "tree", TASKS[:2], SOLVERS[:4], frames_per_level=9, modes=("own", "shared"))
    data = write_frames(folder / "data", TASKS[:2], frames_per_level=9)
    return write_site(make_boards(root), Places(root, data)).parent


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


def shown(driver, selector):
    return [element for element in driver.find_elements("css selector", selector) if element.is_displayed()]


def column(driver, table, place):
    rows = shown(driver, f"#{table} tbody tr")
    return [row.find_elements("css selector", "th, td")[place].text.split("\n")[0] for row in rows]


@pytest.mark.parametrize("width", [PHONE_PX, 1300])
@pytest.mark.parametrize("dark", [False, True])
def test_no_page_complains_asks_outside_or_scrolls_sideways(driver, site, width, dark):
    pages = sorted(site.glob("*.html"))
    assert len(pages) == 1 + 4 + 4 + 4
    for page in pages:
        open_page(driver, page, width, dark)
        driver.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; });")
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width, page.name
        assert console(driver) == [], page.name
        outside = [url for url in requested(driver) if not url.startswith(("file:", "data:"))]
        assert outside == [], page.name
        background = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert background == ("rgb(20, 23, 27)" if dark else "rgb(253, 253, 251)")


def test_headings_sort_by_mouse_and_keyboard(driver, site):
    open_page(driver, site / "bortle@1-dev-own.html")
    header = driver.find_element("css selector", "#results thead th:nth-child(2)")
    assert header.text.startswith("success")
    header.find_element("css selector", "button").click()
    assert header.get_attribute("aria-sort") == "descending"
    values = [float(text.removesuffix(" %")) for text in column(driver, "results", 1)]
    assert values == sorted(values, reverse=True)
    header.find_element("css selector", "button").send_keys("\ue007")  # Enter
    assert header.get_attribute("aria-sort") == "ascending"
    values = [float(text.removesuffix(" %")) for text in column(driver, "results", 1)]
    assert values == sorted(values)
    other = driver.find_element("css selector", "#results thead th:nth-child(1) button")
    other.send_keys(" ")
    assert header.get_attribute("aria-sort") is None
    names = column(driver, "results", 0)
    assert names == sorted(names)


def test_infinite_numbers_sort_as_numbers_and_undefined_ones_last(driver, site):
    open_page(driver, site / "bortle@1-dev-own.html")
    page = driver.find_element("css selector", "#results")
    driver.execute_script(
        "const cells = [...arguments[0].tBodies[0].rows].map((row) => row.cells[1]);"
        "['', 'Infinity', '-Infinity', '7'].forEach((value, n) => { cells[n].dataset.value = value; });",
        page,
    )
    read = "return [...arguments[0].tBodies[0].rows].map((row) => row.cells[1].dataset.value)"
    button = page.find_element("css selector", "thead th:nth-child(2) button")
    button.click()
    assert driver.execute_script(read, page) == ["Infinity", "7", "-Infinity", ""]
    button.click()
    assert driver.execute_script(read, page) == ["-Infinity", "7", "Infinity", ""]


def test_filters_hide_rows_columns_and_say_how_many_are_left(driver, site):
    open_page(driver, site / "index.html")
    status = driver.find_element("css selector", ".filters output")
    assert status.text == "8 of 16 results"  # one mode of detections is chosen at first
    choose(driver, "detections", "")
    assert status.text == "16 of 16 results"
    assert len(shown(driver, "#all-results tbody tr")) == 16
    choose(driver, "task", "motion@1")
    assert status.text == "8 of 16 results"
    assert set(column(driver, "all-results", 1)) == {"motion@1"}
    assert len(shown(driver, "#matrix-success thead th")) == 3
    choose(driver, "family", "peers")
    assert set(column(driver, "all-results", 0)) == {"tetra3rs", "ruststartracker"}
    assert set(column(driver, "matrix-success", 0)) == {"tetra3rs", "ruststartracker"}
    choose(driver, "measure", "break")
    assert not shown(driver, "#matrix-success")
    assert shown(driver, "#matrix-break")
    driver.find_element("css selector", ".filters [type=reset]").click()
    driver.execute_async_script("setTimeout(arguments[0], 50)")
    assert status.text == "8 of 16 results"


def choose(driver, name, value):
    select = driver.find_element("css selector", f".filters select[name={name}]")
    driver.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('change', {bubbles: true}));",
        select,
        value,
    )


def test_links_lead_from_the_leaderboard_to_a_solver_and_on_to_its_worst_frame(driver, site):
    open_page(driver, site / "index.html")
    driver.find_element("link text", "thesis-baseline+si+pr").click()
    assert driver.find_element("css selector", "h1").text == "thesis-baseline+si+pr"
    driver.find_element("link text", "look at it").click()
    card = driver.find_element("css selector", ".card:target")
    assert "thesis-baseline+si+pr" in card.text
    assert console(driver) == []


LOADED = "return arguments[0].complete && arguments[0].naturalWidth > 0"


def test_all_failures_are_listed_filtered_and_shown_with_what_the_solver_saw(driver, site):
    open_page(driver, site / "index.html")
    driver.find_element("link text", "thesis-baseline+si+pr").click()
    driver.find_element("link text", "all its failures").click()
    status = driver.find_element("css selector", "#failure-filters output")
    assert set(column(driver, "failure-list", 1)) == {"thesis-baseline+si+pr"}
    mine = int(status.text.split()[-2])
    assert len(shown(driver, "#failure-list tbody tr")) == min(mine, 50)
    driver.find_element("css selector", "#failure-filters [type=reset]").click()
    driver.execute_async_script("setTimeout(arguments[0], 50)")
    every = int(status.text.split()[-2])
    assert every > max(mine, 50)
    driver.find_element("css selector", ".pager [name=on]").click()
    assert status.text.startswith("51 to 100 of")
    search = driver.find_element("css selector", "#failure-filters [name=words]")
    search.send_keys("too few stars")
    assert all("too few stars" in text for text in column(driver, "failure-list", 3))
    search.clear()
    search.send_keys("frame-00080")
    assert 0 < len(shown(driver, "#failure-list tbody tr")) <= 4
    driver.find_element("css selector", "#failure-list tbody button").click()
    figure = driver.find_element("css selector", "#shown")
    assert "frame-00080" in figure.text
    for image in figure.find_elements("css selector", "img"):
        assert image.is_displayed()
        WebDriverWait(driver, 10).until(lambda page, one=image: page.execute_script(LOADED, one))
    assert console(driver) == []


def test_filters_work_by_keyboard(driver, site):
    open_page(driver, site / "index.html")
    driver.find_element("css selector", ".filters select[name=task]").send_keys("motion")
    assert set(column(driver, "all-results", 1)) == {"motion@1"}


def test_the_first_tab_skips_to_the_content(driver, site):
    open_page(driver, site / "index.html")
    driver.find_element("css selector", "body").send_keys("\ue004")  # Tab
    first = driver.switch_to.active_element
    assert first.text == "Skip to the content"
    assert first.is_displayed()
    first.send_keys("\ue007")
    assert driver.switch_to.active_element.get_attribute("id") == "main"


def test_the_page_turns_dark_and_stays_so(driver, site):
    open_page(driver, site / "index.html")
    button = driver.find_element("css selector", "#theme")
    assert button.text == "Dark page"
    button.click()
    assert button.text == "Light page"
    WebDriverWait(driver, 10).until(
        lambda page: page.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
    )
    open_page(driver, site / "bortle@1-dev-own.html")
    WebDriverWait(driver, 10).until(
        lambda page: page.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
    )
    driver.find_element("css selector", "#theme").click()
    driver.execute_script("localStorage.clear()")


def test_a_worst_frame_is_enlarged_by_its_link(driver, site):
    open_page(driver, site / "bortle@1-dev-own.html")
    card = driver.find_element("css selector", "#worst-2")
    before = card.size["width"]
    card.find_element("css selector", "a.picture").send_keys("\ue007")
    assert card.size["width"] > 2 * before
    assert card.find_element("css selector", ".close").is_displayed()


def test_panels_show_axes_and_curves_and_no_black_shapes(driver, site):
    """Copies of a shared backdrop take their style only from rules that name nothing outside of it."""
    open_page(driver, site / "bortle@1-dev-own.html")
    panel = driver.find_element("css selector", ".small svg.panel")
    driver.execute_script("arguments[0].scrollIntoView();", panel)
    with Image.open(io.BytesIO(panel.screenshot_as_png)) as opened:
        grey = np.asarray(opened.convert("L"))
    assert (grey < 245).mean() > 0.02
    assert (grey < 60).mean() < 0.01
