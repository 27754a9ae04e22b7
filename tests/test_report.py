"""The report is one file that holds the study, works in a browser and asks nobody for anything."""

import numpy as np
import pandas as pd
import pytest
from browser import chromium, requested
from study_table import NASTY, study_table

import sweepopt as so
from sweepopt.cli import main
from sweepopt.study import write_report
from sweepopt.study.diagram import COSTS, UNKNOWN
from sweepopt.study.hard.stiff import StiffRow
from sweepopt.study.hard.velocities import HardRow
from sweepopt.study.problems import problem

TITLE = "What <accuracy> & certainty cost"
BLOCK = problem("S03")
RUNS = {
    "block": so.solve(BLOCK.process(), t_end=BLOCK.t_end, steps=80),
    "adaptive": so.solve(BLOCK.process(), t_end=1.0, steps=so.Adaptive(1e-3)),
}
MET = HardRow(
    *("threshold", 3, "full", "osqp", "each load is its friction bound", "|z| = 0, 0 of 36 move"),
    *(2e-13, 4e-12, 0.0, 0.0021, "met"),
)
HARD = (
    MET,
    MET._replace(solver="clarabel", error=3e-10, seconds=0.5),
    MET._replace(family="condition", error=2e-6, verdict="certificate below the error"),
    MET._replace(family="condition", solver="clarabel", error=np.nan, verdict=NASTY),
    HardRow("empty", 3, "full", "osqp", answer="refuse: EmptySetError", verdict="refused"),
)
WALL, STEPS = 0, 2  # diagrams of the page, a cost each


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    assert write_report(study_table(), path, solutions=RUNS, hard=HARD, title=TITLE) == path
    return path


class Browser:
    """Headless Chromium with the report open."""

    def __init__(self, driver):
        self.driver = driver

    def traces(self, diagram):
        """What a diagram draws, as the browser has it."""
        script = (
            "const all = document.querySelectorAll('.plotly-graph-div')[arguments[0]]._fullData;"
            "return all.map(t => ({name: t.name, x: [...t.x], y: [...t.y], visible: t.visible}))"
        )
        return list(self.driver.execute_script(script, diagram))

    def rows(self, table):
        """The words of a table, its heading first."""
        script = (
            "return [...document.querySelectorAll('table')[arguments[0]].rows].map("
            "row => [...row.cells].map(cell => cell.textContent))"
        )
        return list(self.driver.execute_script(script, table))

    def all(self, selector, diagram=None):
        """Elements of the page or of a diagram."""
        where = self.driver if diagram is None else self.all(".plotly-graph-div")[diagram]
        return list(where.find_elements("css selector", selector))

    def point_at(self, element):
        from selenium.webdriver.common.action_chains import ActionChains

        return ActionChains(self.driver).scroll_to_element(element).move_to_element(element)

    def wait_for(self, condition):
        from selenium.webdriver.support.wait import WebDriverWait

        WebDriverWait(self.driver, 10).until(lambda _: condition())

    def text(self):
        return str(self.all("body")[0].text)


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    """The page, opened once; afterwards: no errors, no requests, no script of a message."""
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        driver.get(page.as_uri())
        opened = Browser(driver)
        opened.wait_for(lambda: len(opened.all(".plotly-graph-div")) == len(COSTS))
        yield opened
        assert driver.execute_script("return window.hacked") is None
        assert driver.get_log("browser") == []
        asked = requested(driver)
    assert page.as_uri() in asked
    assert all(url == page.as_uri() or url.startswith(("data:", "blob:")) for url in asked)


def test_the_diagrams_hold_the_numbers_of_the_table(browser):
    table = study_table()
    traces = browser.traces(WALL)
    good = table[table.success & (table.error > 0)]
    for (_, scheme, solver), rows in good.groupby(["problem", "scheme", "solver"]):
        assert any(
            trace["name"] == f"{scheme} · {solver}"
            and trace["x"] == rows.wall.tolist()
            and trace["y"] == rows.error.tolist()
            for trace in traces
        )
    drawn = [trace["name"] for trace in traces for _ in trace["x"]]
    assert (drawn.count("failed"), drawn.count(UNKNOWN)) == (5, 2)
    assert len(drawn) - drawn.count("guaranteed bound") == len(table)


def test_trajectories_are_a_picture_in_the_page(browser):
    (picture,) = browser.all("img")
    assert picture.get_property("naturalWidth") > 100
    assert str(picture.get_attribute("src")).startswith("data:image/svg+xml;base64,")


def test_a_tooltip_tells_a_cell_and_a_message_is_text(browser):
    point = browser.all(".scatterlayer .point", WALL)[0]
    browser.point_at(point).perform()
    browser.wait_for(lambda: bool(browser.all(".hovertext", WALL)))
    words = browser.all(".hovertext", WALL)[0].text
    # of catching-up or of implicit-euler, which have the same errors in this table
    for part in ("solver=clarabel", "steps=50", "error=0.006", "bound=0.0102"):
        assert part in words
    assert NASTY[:20] in browser.text()


def test_hard_cases_come_with_the_wrong_ones_first(browser):
    names, *rows = browser.rows(3)
    shown = pd.DataFrame(rows, columns=names)
    assert shown.verdict.str.startswith("✗").tolist() == [True, True, False, False, False]
    assert shown.error.tolist() == ["2e-06", "-", "2e-13", "3e-10", "-"]
    assert shown.answer.iloc[-1] == "refuse: EmptySetError"
    for words in ("5 runs, 2 wrong", "each load is its friction bound"):
        assert words in browser.text()


def test_the_heading_names_machine_and_versions(browser):
    shown = browser.text()
    assert browser.driver.title == TITLE == shown.splitlines()[0]
    for words in ("A processor, 2 cores, Linux", "sweepopt 0.1.0", "clarabel 0.11.1"):
        assert words in shown.splitlines()[1]
    assert "49 runs, 5 failed" in shown
    assert browser.driver.execute_script("return document.documentElement.scrollWidth") <= 1400


def test_the_table_holds_every_cell_the_failed_ones_first(browser):
    table = study_table()
    names, *rows = browser.rows(2)
    shown = pd.DataFrame(rows, columns=names)
    assert len(shown) == len(table)
    assert shown.status.str.startswith("✗").tolist() == [True] * 5 + [False] * 44
    assert shown.message[0] == NASTY
    errors = pd.to_numeric(shown.error, errors="coerce").dropna()
    np.testing.assert_allclose(sorted(errors), sorted(table.error.dropna()), rtol=0.01)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda path: write_report(None, path), "there are no hard cases: nothing to report"),
        (lambda path: write_report(study_table(), path / "no" / "a.html"), "there is no folder"),
        (lambda path: write_report(study_table(), path.parent), "is no regular file"),
    ],
)
def test_what_cannot_be_shown_is_refused(call, words, tmp_path):
    with pytest.raises(so.InputError, match=words):
        call(tmp_path / "report.html")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow  # .ci/run runs it
def test_a_study_with_hard_cases_writes_its_files_goes_on_and_keeps_rows_of_an_interrupt(
    tmp_path, monkeypatch, capsys
):
    path, out = tmp_path / "both.toml", tmp_path / "out"
    with_hard = (
        'title = "Both"\nproblems = ["S01"]\nschemes = ["midpoint"]\n'
        'solvers = ["auto"]\nsteps = [20]\nrepeats = 1\n[hard]\nfamilies = ["threshold"]\n'
        'solvers = ["auto"]\npaths = ["full"]\ncombinations = 0\n'
    )
    path.write_text(
        f'{with_hard}[trajectories]\ntrajectories = ["grazing"]\nschemes = ["auto"]\n'
        '[stiff]\nbodies = ["one mass"]\nloads = ["tables"]\nstiffness = [100.0]\n'
    )
    assert main(["study", str(path), "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert "1 runs, 0 of them finished before" in shown.err
    assert "the fastest way to each relative error" in shown.out
    assert shown.out.endswith(
        f"{out}: table.csv, diagram.png, hard.csv, trajectories.csv, stiff.csv, report.html\n"
    )
    assert "bound_over_error" in shown.out
    page = (out / "report.html").read_text("utf-8")
    for words in ("<title>Both</title>", "1 runs, 0 failed", "Stiff bodies"):
        assert words in page
    assert page.count("1 runs, 0 wrong") == 3
    assert list(pd.read_csv(out / "table.csv").problem) == ["S01"]
    assert len(pd.read_csv(out / "hard.csv")) == 1
    assert set(pd.read_csv(out / "trajectories.csv").verdict) == {"met"}
    stiff = pd.read_csv(out / "stiff.csv")
    assert (*stiff.columns,) == StiffRow._fields
    assert stiff.scheme.tolist() == ["sdirk32"]

    def interrupted(*_):
        yield from HARD
        raise KeyboardInterrupt

    path.write_text(with_hard)
    monkeypatch.setattr("sweepopt.study.hard.velocities._runs", interrupted)
    assert main(["study", str(path), "--out", str(out)]) != 0
    assert "1 runs, 1 of them finished before" in capsys.readouterr().err
    kept = pd.read_csv(out / "hard.csv", keep_default_na=False)
    assert kept.verdict.tolist() == [row.verdict for row in HARD]
    assert list(kept.columns) == list(HardRow._fields)
