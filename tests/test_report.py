"""The report is one file that holds the table, runs in a browser and asks nobody for anything."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.select import Select
from study_table import NASTY, WARNED, study_table

import sweepopt as so
from sweepopt.cli import main
from sweepopt.study import Trajectory, write_report
from sweepopt.study.hard.table import HardRow

TITLE = "What <accuracy> & certainty cost"
T = np.linspace(0.0, 8.0, 81)
RUNS = (
    Trajectory("block", "midpoint", 80, T, np.sin(T), 0.02 * T, "displacement (mm)"),
    Trajectory("block", "catching-up", 80, T, np.sin(T - 0.05), None, "displacement (mm)"),
    Trajectory("pipe", "midpoint", 80, T, np.tanh(T), np.full(81, 0.5), "flow rate"),
)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    assert write_report(study_table(), path, trajectories=RUNS, title=TITLE) == path
    return path


def data_of(page: Path) -> dict[str, Any]:
    (text,) = re.findall(
        r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8")
    )

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    return dict(json.loads(text, parse_constant=refuse))


class Browser:
    """Headless Chromium with the report open."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def all(self, selector: str) -> list[Any]:
        return list(self.driver.find_elements(By.CSS_SELECTOR, selector))

    def one(self, selector: str) -> Any:
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, selector: str) -> None:
        self.one(selector).click()

    def rows(self) -> list[int]:
        """The cells of the table, in its order."""
        return [int(row.get_attribute("data-cell")) for row in self.all("#table tbody tr")]

    def marks(self) -> list[int]:
        """The cells of the diagram."""
        return sorted(int(mark.get_attribute("data-cell")) for mark in self.all("#diagram .mark"))

    def value(self, cell: int, column: str) -> str:
        selector = f'#table tr[data-cell="{cell}"] td[data-column="{column}"]'
        return str(self.one(selector).text).split("\n")[0]

    def reach(self, selector: str) -> Any:
        """Focus an element as the keyboard would."""
        element = self.one(selector)
        self.driver.execute_script("arguments[0].focus()", element)
        return element


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not chromium or not chromedriver:
        reason = "the apt packages chromium and chromium-driver are not installed"
        if os.environ.get("SWEEPOPT_BROWSER") == "required":
            pytest.fail(reason)
        pytest.skip(reason)
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for switch in (
        "headless",
        "no-sandbox",
        "disable-gpu",
        "disable-dev-shm-usage",
        "disable-quic",
        "no-first-run",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        "window-size=1000,900",
        f"user-data-dir={tmp_path_factory.mktemp('chromium')}",
    ):
        options.add_argument(f"--{switch}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=webdriver.ChromeService(chromedriver))
    started.get("about:blank")  # leaves Chromium's own first page
    yield started
    started.quit()


@pytest.fixture
def browser(driver: Any, page: Path) -> Iterator[Browser]:
    yield from watched(driver, page)


def watched(driver: Any, page: Path) -> Iterator[Browser]:
    """The page, freshly opened; afterwards: no errors, no requests, no script of a message."""
    for kind in ("browser", "performance"):
        driver.get_log(kind)  # forget what was before
    driver.get(page.as_uri())
    yield Browser(driver)
    assert driver.execute_script("return window.hacked") is None
    assert driver.get_log("browser") == []
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert set(asked) <= {page.as_uri(), "data:,"}
    assert page.as_uri() in asked


def test_a_filter_acts_on_table_and_diagram(browser: Browser) -> None:
    table = study_table()
    assert browser.rows() == browser.marks() == list(range(len(table)))
    assert browser.one("#count").text == "49 of 49 cells"

    browser.click('[data-filter="problem:pipe"]')
    browser.click('[data-filter="solver:osqp"]')
    wanted = table.index[(table.problem == "pipe") & (table.solver == "osqp")].tolist()
    assert browser.rows() == browser.marks() == wanted
    assert [panel.text for panel in browser.all("figcaption")] == ["pipe"]
    assert browser.one("#count").text == "12 of 49 cells"
    cell = table.index[(table.problem == "pipe") & (table.scheme == "midpoint")][0] + 4
    assert browser.value(cell, "solver") == "osqp"
    assert float(browser.value(cell, "error")) == pytest.approx(table.error[cell], rel=0.05)
    assert browser.value(cell, "error") == "8.0e-4"
    assert browser.value(cell, "wall") == "0.015"

    browser.click("#clear")
    assert browser.rows() == browser.marks() == list(range(len(table)))


def test_failures_are_seen_with_their_message_as_text(browser: Browser) -> None:
    table = study_table()
    failed = table.index[~table.success].tolist()
    shown = [int(row.get_attribute("data-cell")) for row in browser.all("#table tr.failed")]
    crosses = [int(mark.get_attribute("data-cell")) for mark in browser.all(".mark.cross")]
    assert shown == sorted(crosses) == failed
    assert browser.one(".tile.bad").text == "5\nfailed"
    reasons = [text.text for text in browser.all("text.reason.failed")]
    assert reasons == ["INEXACT: 3 cells", "UnstableStepError: 2 cells"]
    message = browser.one(f'#table tr[data-cell="{failed[0]}"] .message')
    assert message.get_property("textContent") == NASTY
    assert len(browser.all("script")) == 2
    others = {message.text for message in browser.all("#table tr:not(.failed) .message")}
    assert others == {WARNED}  # what is usual is not said in each row

    browser.click('[data-filter="outcome:failed"]')
    assert browser.rows() == browser.marks() == failed
    assert browser.value(failed[0], "status") == "✗ INEXACT"
    assert browser.value(failed[0], "error") == "\N{EN DASH}"
    assert browser.value(failed[-1], "bound") == "∞"
    assert browser.value(failed[-1], "solver_calls") == "\N{EN DASH}"


def test_a_column_sorts_and_the_unknown_comes_last(browser: Browser) -> None:
    table = study_table()
    browser.click('[data-sort="error"]')
    best = table.error.sort_values(kind="stable", na_position="last").index.tolist()
    assert browser.rows() == best
    assert browser.one('th[aria-sort="ascending"]').text.startswith("error")
    browser.click('[data-sort="error"]')
    assert table.error[browser.rows()[0]] == table.error.max()
    assert np.isnan(table.error[browser.rows()[-1]])


def test_axes_can_be_chosen_and_series_hidden(browser: Browser) -> None:
    Select(browser.one("#x")).select_by_value("solver_calls")
    Select(browser.one("#y")).select_by_value("bound")
    names = [name.text for name in browser.all("#diagram figure:first-child text.name")]
    assert names == ["solver calls", "bound of the error"]
    assert len(browser.all("#diagram .mark.open")) == 24 - 2 + 1  # not guaranteed, or unknown

    Select(browser.one("#y")).select_by_value("error")
    assert browser.all("#diagram .bound")
    browser.click('[data-series="guaranteed bound"]')
    assert not browser.all("#diagram .bound")
    browser.click('[data-series="midpoint · osqp"]')
    table = study_table()
    kept = table.index[(table.scheme != "midpoint") | (table.solver != "osqp")].tolist()
    assert browser.marks() == kept
    assert browser.rows() == list(range(len(table)))
    assert browser.one('[data-series="midpoint · osqp"]').get_attribute("aria-pressed") == "false"


def test_marks_lie_where_their_values_are(browser: Browser) -> None:
    browser.click('[data-filter="problem:block"]')
    table = study_table()
    good = table[(table.problem == "block") & table.success & (table.error > 0.0)]
    places = []
    for cell in good.index:
        transform = browser.one(f'.mark[data-cell="{cell}"]').get_attribute("transform")
        places.append([float(number) for number in re.findall(r"[\d.]+", transform)])
    for values, place in zip((good.wall, good.error), np.transpose(places), strict=True):
        slope, start = np.polyfit(np.log10(values), place, 1)
        np.testing.assert_allclose(place, slope * np.log10(values) + start, atol=0.1)
        assert abs(slope) > 20.0


def test_keyboard_and_pointer_read_a_cell(browser: Browser) -> None:
    table = study_table()
    browser.driver.execute_cdp_cmd("Emulation.setFocusEmulationEnabled", {"enabled": True})
    first = browser.reach('#diagram .mark[tabindex="0"]')
    assert browser.one("#tip").is_displayed()
    first.send_keys(Keys.ARROW_RIGHT)
    mark = browser.driver.switch_to.active_element
    assert mark.get_attribute("data-cell") != first.get_attribute("data-cell")
    cell = int(mark.get_attribute("data-cell"))
    tip = browser.one("#tip").text
    assert f"{table.scheme[cell]} · {table.solver[cell]}" in tip
    assert str(table.steps[cell]) in tip
    mark.send_keys(Keys.ENTER)
    row = browser.driver.switch_to.active_element
    assert (row.tag_name, row.get_attribute("data-cell")) == ("tr", str(cell))

    cross = browser.one(".mark.cross")
    ActionChains(browser.driver).scroll_to_element(cross).move_to_element(cross).perform()
    assert NASTY.split("<")[0] in browser.one("#tip").text


def test_the_band_is_drawn_around_its_trajectory(browser: Browser) -> None:
    (band,) = browser.all("#curves .band")
    corners = np.array([p.split(",") for p in band_points(browser, band)], dtype=float)
    upper, lower = corners[:81], corners[81:][::-1]
    np.testing.assert_allclose(upper[:, 0], lower[:, 0])
    widths = lower[:, 1] - upper[:, 1]  # pixels count downwards
    np.testing.assert_allclose(widths, widths[-1] * T / 8.0, atol=0.03)
    assert widths[-1] > 10.0
    assert len(browser.all("#curves .line")) == 2

    picture = browser.reach("#curves svg")
    picture.send_keys(Keys.ARROW_RIGHT * 10)
    text = browser.one("#reading").text
    assert text.startswith("t = 1 ")
    assert f"{np.sin(1.0):.5f} ± 0.02" in text

    Select(browser.one("#picture")).select_by_visible_text("pipe: flow rate")
    assert "± 0.5 at most" in browser.one("#runs").text
    browser.click("#runs button")
    assert not browser.all("#curves .band, #curves .line")


def band_points(browser: Browser, band: Any) -> list[str]:
    script = "return [...arguments[0].points].map((p) => `${p.x},${p.y}`)"
    return list(browser.driver.execute_script(script, band))


@pytest.mark.parametrize("width", [360, 1000])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_the_screen_in_both_colour_schemes(
    browser: Browser, width: int, scheme: str
) -> None:
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.driver.refresh()
    wide = browser.driver.execute_script("return document.documentElement.scrollWidth")
    paper = browser.one("body").value_of_css_property("background-color")
    ink = browser.one("h1").value_of_css_property("color")
    browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert wide <= width
    brightness = [sum(map(int, re.findall(r"\d+", colour)[:3])) for colour in (paper, ink)]
    assert (brightness[0] > brightness[1] + 400) == (scheme == "light")
    assert abs(brightness[0] - brightness[1]) > 400


def test_the_heading_names_machine_and_versions(browser: Browser) -> None:
    assert browser.driver.title == browser.one("h1").text == TITLE
    assert "A processor, 2 cores, Linux" in browser.one("#when").text
    versions = browser.one("#versions").text.replace("\n", " ")
    for name in ("sweepopt 0.1.0", "numpy 2.4.6", "clarabel 0.11.1", "python 3.11.7"):
        assert name in versions


def test_the_data_are_json_and_hold_every_value(page: Path) -> None:
    table, data = study_table(), data_of(page)
    assert len(data["cells"]) == len(table)
    for cell, row in zip(data["cells"], table.to_dict("records"), strict=True):
        assert set(cell) == set(row)
        for name, value in row.items():
            if isinstance(value, float) and not np.isfinite(value):
                assert cell[name] == ("inf" if value > 0 else None)
            else:
                assert cell[name] == value
    np.testing.assert_array_equal(data["trajectories"][0]["band"], RUNS[0].band)


def test_the_file_names_no_other_place(page: Path) -> None:
    text = page.read_text("utf-8")
    assert set(re.findall(r"https?://[^\s\"'<]+", text)) == {"http://www.w3.org/2000/svg"}
    assert "default-src 'none'" in text
    assert not re.search(r"@import|url\(|innerHTML|eval\(", text)


def test_a_table_that_went_through_csv_gives_the_same_cells(page: Path, tmp_path: Path) -> None:
    study_table().to_csv(tmp_path / "study.csv", index=False)
    again = write_report(pd.read_csv(tmp_path / "study.csv", dtype={"cell": str}), tmp_path / "a")
    assert data_of(again)["cells"] == data_of(page)["cells"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda path: write_report(study_table()[["problem"]], path), "table lacks the columns"),
        (lambda path: write_report(None, path), "there are no hard cases: nothing to report"),
        (lambda path: write_report(study_table(), path / "no" / "a.html"), "does not exist"),
        (lambda path: write_report(study_table(), path.parent), "is a folder; name a file in it"),
        (lambda path: write_report(study_table(), path, trajectories=[T]), r"trajectories\[0\]"),
        (lambda path: Trajectory("p", "s", 9, T, T[1:]), "u must have 81 entries, got 80"),
        (lambda path: Trajectory("p", "s", 9, T[::-1], T), "each later than the one before"),
        (lambda path: Trajectory("p", "s", 9, T, T, -T), r"band\[1\] is -0.1; give half-widths"),
        (lambda path: Trajectory("p", "s", 9, T, T * np.nan), r"u\[0\] is nan"),
        (lambda path: Trajectory("p", "s", 0, T, T), "steps must be a positive whole number"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    call: Callable[[Path], Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(so.InputError, match=words):
        call(tmp_path / "report.html")
    assert not list(tmp_path.iterdir())


# ---- the page of hard cases -------------------------------------------------------------------

RIGHT = HardRow(
    *("threshold", 3, "full", "osqp", "", "|z| = 0, 0 of 36 move"),
    *(2e-13, 4e-12, 0.0, "at rest", 0, 0.0021, "met"),
)
HARD = (
    RIGHT,
    RIGHT._replace(solver="clarabel", rung="clarabel", error=3e-10, attempts=4, seconds=0.5),
    RIGHT._replace(
        family="condition", path="eliminated", drawn="mixed units", answer="|z| = 2.5, 9 of 36 move"
    ),
    RIGHT._replace(
        family="condition", error=2e-6, certificate=1e-9, verdict="certificate below the error"
    ),
    RIGHT._replace(family="condition", solver="clarabel", error=np.nan, rung="", verdict=NASTY),
    HardRow(
        *("empty", 3, "full", "osqp", "", "refuse: EmptySetError"),
        *(np.nan, np.nan, np.nan, "", 0, np.nan, "refused"),
    ),
)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("both") / "report.html"
    return write_report(study_table(), path, trajectories=RUNS, hard=HARD, title=TITLE)


@pytest.fixture
def opened(driver: Any, both: Path) -> Iterator[Browser]:
    yield from watched(driver, both)


def hard_rows(browser: Browser) -> list[list[str]]:
    rows = browser.all("#hard-table tbody tr")
    return [[cell.text for cell in row.find_elements(By.TAG_NAME, "td")] for row in rows]


def test_hard_cases_are_a_page_of_the_report(opened: Browser) -> None:
    assert [button.text for button in opened.all("#pages button")] == [
        "What accuracy costs",
        "Hard cases",
    ]
    assert opened.one("#study").is_displayed()
    assert not opened.one("#hard").is_displayed()
    opened.click('[data-page="hard"]')
    assert opened.one("#hard").is_displayed()
    assert not opened.one("#study").is_displayed()
    assert opened.one('[data-page="hard"]').get_attribute("aria-pressed") == "true"
    rows = hard_rows(opened)
    assert len(rows) == len(HARD)
    assert rows[0][0].startswith("threshold\nEach load is its friction bound")
    assert rows[0][1:] == [
        *("3", "full", "osqp", "|z| = 0, 0 of 36 move", "2.0e-13", "4.0e-12", "at rest", "0"),
        *("2.1", "✓ met"),
    ]
    nothing = "\N{EN DASH}"
    refused = ["refuse: EmptySetError", nothing, nothing, "none", nothing, nothing, "✓ refused"]
    assert rows[5][4:] == refused
    opened.click('[data-page="study"]')
    assert opened.marks() == list(range(49))
    assert opened.one("#curves svg").is_displayed()


def test_wrong_answers_are_seen_first_of_all(opened: Browser) -> None:
    opened.click('[data-page="hard"]')
    assert opened.one("#hard .tile.bad").text == "2\nwrong"
    reasons = opened.one("#hard .reasons").text
    assert reasons.startswith("certificate below the error \N{MULTIPLICATION SIGN} 1, ")
    assert NASTY.split("<")[0] in reasons
    assert len(opened.all("#hard tr.failed")) == 2
    (hidden,) = opened.all(
        "#hard tr.failed:last-of-type .badge, #hard tr.failed + tr.failed .badge"
    )
    assert hidden.get_property("textContent") == "✗ " + NASTY
    assert len(opened.all("script")) == 2


def test_hard_cases_are_filtered_and_sorted(opened: Browser) -> None:
    opened.click('[data-page="hard"]')
    assert opened.one("#hard-count").text == "6 of 6 runs"
    opened.click('#hard-filters [data-filter="family:condition"]')
    opened.click('#hard-filters [data-filter="outcome:wrong"]')
    assert opened.one("#hard-count").text == "2 of 6 runs"
    assert {row[0].split("\n")[0] for row in hard_rows(opened)} == {"condition"}
    assert opened.all('#hard-filters [data-filter="solver:osqp"] small')[0].text == "1"
    opened.click("#hard-clear")
    opened.click('#hard-table [data-sort="error"]')
    found = [row[5] for row in hard_rows(opened)]
    assert found == ["2.0e-13", "2.0e-13", "3.0e-10", "2.0e-6", "\N{EN DASH}", "\N{EN DASH}"]
    assert opened.one("#study .scroller").get_attribute("id") == "table"
    opened.click('[data-page="study"]')
    assert opened.one("#count").text == "49 of 49 cells"  # the other page has filters of its own


def test_hard_cases_alone_are_a_report_with_versions(driver: Any, tmp_path: Path) -> None:
    path = write_report(None, tmp_path / "report.html", hard=HARD, title="Hard cases")
    for browser in watched(driver, path):
        assert browser.one("#hard").is_displayed()
        assert not browser.one("#study").is_displayed()
        assert not browser.all("#pages button")
        assert len(hard_rows(browser)) == len(HARD)
        versions = browser.one("#versions").text.replace("\n", " ")
        assert f"sweepopt {so.__version__}" in versions
        assert f"numpy {np.__version__}" in versions
        assert "cores" in browser.one("#when").text
        assert browser.driver.execute_script("return document.documentElement.scrollWidth") <= 1000


def test_a_study_file_with_hard_cases_writes_one_report(tmp_path: Path) -> None:
    path = tmp_path / "both.toml"
    path.write_text(
        'title = "Both"\nproblems = ["S01"]\nschemes = ["midpoint"]\nsolvers = ["auto"]\n'
        'steps = [20]\nrepeats = 1\n[hard]\nfamilies = ["threshold"]\nsolvers = ["auto"]\n'
        'paths = ["full"]\ncombinations = 0\n'
    )
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 0
    data = data_of(tmp_path / "out" / "report.html")
    assert data["title"] == "Both"
    assert len(data["cells"]) == len(data["hard"]["rows"]) == 1
    assert data["hard"]["rows"][0]["good"]
    assert (tmp_path / "out" / "hard.csv").exists()
    assert (tmp_path / "out" / "table.csv").exists()
