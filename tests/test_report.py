"""The report is one file that holds the study and asks nobody for anything."""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from study_table import NASTY, study_table
from test_cli import make_scene

import sweepopt as so
from sweepopt.cli import main
from sweepopt.study import write_report
from sweepopt.study.hard.programs import HardRow, HardStudy
from sweepopt.study.problems import problem
from sweepopt.study.records import read_rows

TITLE = "What <accuracy> & certainty cost"
BLOCK = problem("S03")
RUNS = {
    "block": so.solve(BLOCK.process(), t_end=BLOCK.t_end, steps=80),
    "adaptive": so.solve(BLOCK.process(), t_end=1.0, steps=so.Adaptive(1e-3)),
}
MET = HardRow(
    *("threshold", 3, "full", "osqp", "each load is its friction bound", "|z| = 0, 0 of 36 move"),
    *(2e-13, 4e-12, 0.0, "at rest", 0, 0.0021, "met"),
)
HARD = (
    MET,
    MET._replace(solver="clarabel", solved_by="clarabel", error=3e-10, attempts=4, seconds=0.5),
    MET._replace(family="condition", error=2e-6, verdict="certificate below the error"),
    MET._replace(family="condition", solver="clarabel", error=np.nan, solved_by="", verdict=NASTY),
    HardRow("empty", 3, "full", "osqp", answer="refuse: EmptySetError", verdict="refused"),
)


class Page(HTMLParser):
    """A page as a browser takes it apart: its text, tables, pictures and tags."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text, self.tags, self.pictures = "", set[str](), list[str]()
        self.tables: list[list[list[str]]] = []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        assert {name for name, _ in attrs}.isdisjoint({"href", "srcset", "onclick", "onload"})
        if tag == "img":
            self.pictures.append(dict(attrs)["src"] or "")
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th", "h1", "h2", "p"):
            self.text += "\n"

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.tables and self.tables[-1] and self.tables[-1][-1]:
            self.tables[-1][-1][-1] += data.strip()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    path = tmp_path_factory.mktemp("report") / "report.html"
    assert write_report(study_table(), path, solutions=RUNS, hard=HARD, title=TITLE) == path
    return Page(path)


def test_the_page_needs_nothing_else_and_runs_nothing(page: Page) -> None:
    assert page.tags.isdisjoint({"script", "link", "iframe", "object", "base"})
    assert len(page.pictures) == 3  # error against time and against steps, trajectories
    for picture in page.pictures:
        kind, _, data = picture.partition(",")
        assert kind == "data:image/svg+xml;base64"
        drawing = ET.fromstring(base64.b64decode(data))
        assert drawing.tag.endswith("svg")
        links = (each.attrib.get("{http://www.w3.org/1999/xlink}href") for each in drawing.iter())
        assert all(link.startswith("#") for link in links if link)


def test_hard_cases_come_with_the_wrong_ones_first(page: Page) -> None:
    assert "5 runs, 2 wrong" in page.text
    names, *rows = page.tables[3]
    shown = pd.DataFrame(rows, columns=names)
    assert shown.verdict.str.startswith("✗").tolist() == [True, True, False, False, False]
    assert shown.error.tolist() == ["2e-06", "-", "2e-13", "3e-10", "-"]
    assert shown.answer.iloc[-1] == "refuse: EmptySetError"
    assert "each load is its friction bound" in page.text


def test_the_heading_names_machine_and_versions(page: Page) -> None:
    for words in (TITLE, "A processor, 2 cores, Linux", "sweepopt 0.1.0", "clarabel 0.11.1"):
        assert words in page.text
    assert "49 cells, 5 failed" in page.text


def test_the_table_holds_every_cell_the_failed_ones_first_and_a_message_is_text(page: Page) -> None:
    table = study_table()
    names, *rows = page.tables[2]
    shown = pd.DataFrame(rows, columns=names)
    assert len(shown) == len(table)
    assert shown.status.str.startswith("✗").tolist() == [True] * 5 + [False] * 44
    assert shown.message[0] == NASTY
    errors = pd.to_numeric(shown.error, errors="coerce").dropna()
    np.testing.assert_allclose(sorted(errors), sorted(table.error.dropna()), rtol=0.01)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda path: write_report(study_table()[["problem"]], path), "table lacks the columns"),
        (lambda path: write_report(None, path), "there are no hard cases: nothing to report"),
        (lambda path: write_report(study_table(), path / "no" / "a.html"), "there is no folder"),
        (lambda path: write_report(study_table(), path.parent), "cannot be written there"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    call: Callable[[Path], Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(so.InputError, match=words):
        call(tmp_path / "report.html")
    assert not list(tmp_path.iterdir())


def test_a_study_with_hard_cases_writes_its_files_goes_on_and_keeps_rows_of_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_scene(tmp_path)
    path, out = tmp_path / "both.toml", tmp_path / "out"
    path.write_text(
        'title = "Both"\nproblems = ["S01", "ring.toml"]\nschemes = ["midpoint"]\n'
        'solvers = ["auto"]\nsteps = [20]\nrepeats = 1\n[hard]\nfamilies = ["threshold"]\n'
        'solvers = ["auto"]\npaths = ["full"]\ncombinations = 0\n'
        '[trajectories]\ntrajectories = ["grazing"]\nschemes = ["auto", "midpoint"]\n'
    )
    assert main(["study", str(path), "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert "2 cells, 0 of them finished before" in shown.err
    assert "the fastest way to each relative error" in shown.out
    assert shown.out.endswith(
        f"{out}: table.csv, diagram.png, hard.csv, trajectories.csv, report.html\n"
    )
    page = (out / "report.html").read_text("utf-8")
    for words in ("<title>Both</title>", "2 cells, 0 failed", "1 runs, 0 wrong", "2 runs, 0 wrong"):
        assert words in page
    assert list(pd.read_csv(out / "table.csv").problem) == ["S01", "ring"]
    assert len(pd.read_csv(out / "hard.csv")) == 1
    assert set(pd.read_csv(out / "trajectories.csv").verdict) == {"met"}

    def interrupted(_: HardStudy) -> Iterator[HardRow]:
        yield from HARD
        raise KeyboardInterrupt

    monkeypatch.setattr(HardStudy, "rows", interrupted)
    assert main(["study", str(path), "--out", str(out)]) != 0
    assert "2 cells, 2 of them finished before" in capsys.readouterr().err
    kept = read_rows(out / "hard.jsonl", HardRow)
    assert list(map(repr, kept)) == list(map(repr, HARD))
