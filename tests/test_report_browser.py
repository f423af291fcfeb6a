"""The HTML page in a real browser: opens from disk, zooms, toggles, dark, on a phone, on paper, and by axe's rules.

Needs Debian's chromium and chromium-driver, and the Python package selenium; axe's rules need axe-core-python. Where
one is absent the tests skip and say which.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import study_factory

from stictionid.comparison import compare
from stictionid.comparison.side_by_side import side_by_side
from stictionid.reports.pages.comparison import write_beside, write_comparison
from stictionid.reports.pages.write import write_report

_PHONE, _DESK, _A4 = 375, 1000, 794  # px; A4 at 96 dots per inch
_PAPER = 718  # px; A4 less its margins
_LEAST_TEXT = 11  # px
_LARGEST = 3_000_000  # bytes of a page
_CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_DRIVER = shutil.which("chromedriver")
_MISSING = [name for name, there in (("chromium", _CHROMIUM), ("chromium-driver", _DRIVER),
                                     ("selenium", importlib.util.find_spec("selenium"))) if not there]
pytestmark = pytest.mark.skipif(bool(_MISSING), reason=f"no {', '.join(_MISSING)} on this machine")
KINDS = ("good", "doubtful", "abstained", "hostile", "searched", "modelled")
PAGES = (*KINDS, "several", "compared", "beside")
# Smallest text of what is seen, in px on the screen: that of a picture shrinks with it.
_SMALLEST = """return Math.min(...[...document.querySelectorAll('main *')].filter(e => e.getClientRects().length &&
  [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim())).map(e => {
    const svg = e.closest('svg[viewBox]');
    const scale = svg ? Math.min(svg.getBoundingClientRect().width / svg.viewBox.baseVal.width,
                                 svg.getBoundingClientRect().height / svg.viewBox.baseVal.height) : 1;
    return parseFloat(getComputedStyle(e).fontSize) * scale}))"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    for kind in KINDS:
        write_report([getattr(study_factory, kind)()], folder / f"{kind}.html")
    modelled = study_factory.modelled()
    write_comparison(compare(modelled.loop, modelled.study), "compared", folder / "compared.html")
    other = replace(modelled, study=replace(modelled.study, steps=modelled.study.steps[:1]), curves=modelled.curves[:1])
    write_beside((other, modelled), side_by_side(other.study, modelled.study), folder / "beside.html")
    write_report([study_factory.good(), study_factory.doubtful(), study_factory.abstained()], folder / "several.html")
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(_CHROMIUM)
    for flag in ("headless", "no-sandbox", "disable-gpu", "no-first-run", "disable-background-networking",
                 "disable-component-update", "disable-sync", "disable-dev-shm-usage",
                 f"user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(_DRIVER)))
    driver.execute_cdp_cmd("Network.enable", {})
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", {"offline": True, "latency": 0, "downloadThroughput": 0,
                                                                "uploadThroughput": 0})
    yield driver
    driver.quit()


def show(browser: Any, path: Path, *, width: int = _DESK, dark: bool = False, media: str = "") -> None:
    """Open a page from disk at a width, with the wanted colour scheme and medium."""
    scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": scheme})
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False})
    browser.get(path.as_uri())
    browser.execute_script("for (const part of document.querySelectorAll('details')) part.open = true")
    frame(browser)


def frame(browser: Any) -> None:
    """Wait until what was asked for is drawn."""
    browser.execute_async_script("const done = arguments[0];"
                                 "requestAnimationFrame(() => requestAnimationFrame(done));")


def nothing_serious(browser: Any, *rules: str) -> None:
    """No serious or critical finding of axe, of all its rules or some; skips where axe is absent."""
    axe = pytest.importorskip("axe_core_python.selenium", reason="no axe-core-python on this machine")
    only: dict[str, Any] = {"runOnly": {"type": "rule", "values": list(rules)}} if rules else {}
    found = axe.Axe().run(browser, options={"resultTypes": ["violations"], **only})
    bad = [(v["id"], v["nodes"][0]["html"][:200]) for v in found["violations"]
           if v["impact"] in ("serious", "critical")]
    assert not bad
    assert len(found["passes"]) == len(rules) if rules else len(found["passes"]) > 15


def trend(browser: Any) -> dict[str, str]:
    return browser.execute_script("return {...document.querySelector('.trend').dataset}")


def press(browser: Any, key: str) -> dict[str, str]:
    from selenium.webdriver.common.by import By

    browser.find_element(By.CSS_SELECTOR, ".plot").send_keys(key)
    frame(browser)
    return trend(browser)


@pytest.mark.parametrize("page", PAGES)
def test_opens_from_disk_offline_without_a_word_on_the_console(browser: Any, pages: Path, page: str) -> None:
    show(browser, pages / f"{page}.html")
    assert browser.get_log("browser") == []
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert not [name for name in loaded if not name.startswith("data:")]
    assert browser.execute_script("return document.documentElement.lang") == "en"
    assert (pages / f"{page}.html").stat().st_size <= _LARGEST


@pytest.mark.parametrize(("page", "width"), [*((page, width) for page in PAGES for width in (_PHONE, _DESK)),
                                             ("several", _A4), ("compared", _A4)])
def test_nothing_is_wider_than_the_screen(browser: Any, pages: Path, page: str, width: int) -> None:
    show(browser, pages / f"{page}.html", width=width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert browser.execute_script(_SMALLEST) >= _LEAST_TEXT


@pytest.mark.parametrize("page", PAGES)
def test_paper_shows_whole_static_pictures(browser: Any, pages: Path, page: str) -> None:
    browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
    show(browser, pages / f"{page}.html", width=_PAPER, media="print")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= _PAPER
    assert browser.execute_script(_SMALLEST) >= _LEAST_TEXT
    heights = browser.execute_script("return [...document.querySelectorAll('figure')].map(f => f.offsetHeight)")
    assert max(heights, default=0) < 1000  # px; a page less its margins is 1,016
    visible = browser.execute_script("return [...document.querySelectorAll('.trend')].filter(e => e.offsetHeight)"
                                     ".length")
    assert visible == 0
    shown = browser.execute_script("return [...document.querySelectorAll('figure.static .desk')]"
                                   ".every(e => e.offsetHeight > 0)")
    assert shown


def test_zoom_by_keyboard_buttons_and_drag(browser: Any, pages: Path) -> None:
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.common.by import By

    show(browser, pages / "good.html")
    assert (trend(browser)["from"], trend(browser)["to"]) == ("0", "599")
    closer = press(browser, "+")
    assert int(closer["to"]) - int(closer["from"]) in (299, 300)
    assert press(browser, Keys.HOME)["to"] == "599"
    browser.find_element(By.CSS_SELECTOR, "[data-do=in]").click()
    frame(browser)
    assert int(trend(browser)["to"]) - int(trend(browser)["from"]) < 310
    browser.find_element(By.CSS_SELECTOR, "[data-do=all]").click()
    canvas = browser.find_element(By.CSS_SELECTOR, ".trend canvas")
    ActionChains(browser).move_to_element_with_offset(canvas, -200, 0).click_and_hold().move_by_offset(200, 0) \
        .release().perform()
    frame(browser)
    dragged = trend(browser)
    assert 0 < int(dragged["from"]) < int(dragged["to"]) < 599
    ActionChains(browser).double_click(canvas).perform()
    frame(browser)
    assert (trend(browser)["from"], trend(browser)["to"]) == ("0", "599")


def test_the_cursor_reads_time_values_and_failing_stretches(browser: Any, pages: Path) -> None:
    from selenium.webdriver import Keys
    from selenium.webdriver.common.by import By

    show(browser, pages / "good.html")
    first, second = press(browser, Keys.ARROW_RIGHT), press(browser, Keys.ARROW_RIGHT)
    assert int(second["cursor"]) == int(first["cursor"]) + 1
    text = browser.find_element(By.CSS_SELECTOR, ".trend output").text
    assert re.search(r"At 30[01] s, 2024-03-01 06:05:0[01]: SP 50.5 m³/h, PV [\d.]+ m³/h, model", text)
    for _ in range(20):
        if int(press(browser, Keys.ARROW_RIGHT * 10)["cursor"]) > 485:
            break
    assert "the model fails here" in browser.find_element(By.CSS_SELECTOR, ".trend output").text


def test_signals_are_switched_off_and_on(browser: Any, pages: Path) -> None:
    from selenium.webdriver.common.by import By

    show(browser, pages / "good.html")
    assert trend(browser)["on"] == "SP,PV,model,OP,measured position,inferred position"
    before = int(trend(browser)["drawn"])
    for box in browser.find_elements(By.CSS_SELECTOR, ".trend input")[:2]:
        box.click()
    frame(browser)
    assert trend(browser)["on"] == "model,OP,measured position,inferred position"
    assert int(trend(browser)["drawn"]) < before


def test_dark_mode_changes_ground_and_curves(browser: Any, pages: Path) -> None:
    ground, ink = [], []
    for dark in (False, True):
        show(browser, pages / "good.html", dark=dark)
        ground.append(browser.execute_script("return getComputedStyle(document.body).backgroundColor"))
        ink.append(trend(browser)["ink"])
    assert ground[0] == "rgb(255, 255, 255)" and ground[1] == "rgb(20, 25, 31)" and ink[0] != ink[1]


def test_a_long_record_is_thinned_to_the_pixels(browser: Any, tmp_path: Path) -> None:
    write_report([study_factory.good(60_000)], tmp_path / "r.html")
    show(browser, tmp_path / "r.html")
    assert 2_000 < int(trend(browser)["drawn"]) < 2 * 6 * _DESK
    whole = int(trend(browser)["drawn"])
    for _ in range(10):
        closer = press(browser, "+")
    assert int(closer["drawn"]) < whole and int(closer["to"]) - int(closer["from"]) < 70


def test_hostile_text_runs_nothing(browser: Any, pages: Path) -> None:
    show(browser, pages / "hostile.html")
    assert browser.execute_script("return document.querySelectorAll('script').length") == 2
    made = "return document.querySelectorAll('main a[href^=javascript], iframe, img').length"
    assert browser.execute_script(made) == 0
    assert "<script>alert" in browser.execute_script("return document.querySelector('h1').textContent")
    text = (pages / "hostile.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text and "\u202e" not in text and "\x1b" not in text


def test_the_comparison_sorts_and_filters(browser: Any, pages: Path) -> None:
    from selenium.webdriver.common.by import By

    show(browser, pages / "several.html")
    names = "return [...document.querySelectorAll('#all tbody tr')].filter(r => r.offsetHeight)" \
            ".map(r => r.cells[0].textContent)"
    assert browser.execute_script(names) == ["FIC101", "LIC7", "TIC9"]
    head = browser.find_elements(By.CSS_SELECTOR, "#all thead button")[2]
    head.click()
    assert browser.execute_script(names) == ["LIC7", "FIC101", "TIC9"]
    assert head.find_element(By.XPATH, "..").get_attribute("aria-sort") == "ascending"
    browser.find_element(By.ID, "filter").send_keys("undecided")
    assert browser.execute_script(names) == ["LIC7", "TIC9"]


def test_the_summary_of_a_batch_sorts_filters_and_opens_a_loops_page(browser: Any, tmp_path: Path) -> None:
    from batch_files import records, write_csv
    from selenium.webdriver.common.by import By

    from stictionid.batch.plan.tasks import plan
    from stictionid.batch.summary.page import write_summary
    from stictionid.batch.task import Work
    from stictionid.batch.work.crew import crew_for
    from stictionid.batch.work.drive import drive
    from stictionid.batch.work.store import Store

    for name, loop in records(3).items():
        write_csv(tmp_path / f"{name}.csv", loop)
    work, store, crew = Work("screen", pages=True), Store(tmp_path / "out"), crew_for(1, None)
    try:
        store.begin()
        drive(plan([str(tmp_path)], work).tasks, work, crew, store)
        write_summary(store)
    finally:
        crew.shutdown(wait=False, cancel_futures=True)
        store.close()
    show(browser, store.folder / "summary.html")
    nothing_serious(browser)
    names = "return [...document.querySelectorAll('tbody tr')].filter(r => r.offsetHeight)" \
            ".map(r => r.cells[0].textContent)"
    browser.find_elements(By.CSS_SELECTOR, "thead button")[0].click()
    assert browser.execute_script(names) == ["FIC100", "FIC101", "FIC102"]
    browser.find_element(By.ID, "filter").send_keys("FIC101")
    assert browser.execute_script(names) == ["FIC101"]
    link = browser.find_element(By.CSS_SELECTOR, "tbody tr:not([hidden]) a")
    assert "/pages/FIC101" in link.get_attribute("href")
    link.click()
    assert "FIC101" in browser.title
    assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


# ("several" holds the first three)
@pytest.mark.parametrize("page", PAGES[3:])
def test_axe_finds_nothing_serious(browser: Any, pages: Path, page: str) -> None:
    show(browser, pages / f"{page}.html")
    nothing_serious(browser)


def test_axe_finds_enough_contrast_on_a_dark_page(browser: Any, pages: Path) -> None:
    """Dark pages share one style sheet, which changes colours alone; three studies show every part that it colours."""
    show(browser, pages / "several.html", dark=True)
    nothing_serious(browser, "color-contrast")
