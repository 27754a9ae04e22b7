"""The site in docs/: the code on its pages runs, its links lead somewhere, what is public is there.

Sphinx itself runs in .ci/run; here are the pages as they are written and made, without it.
"""

import importlib
import os
import re
import shlex
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from browser import chromium, requested
from cases import slow

import sweepopt as so
from sweepopt import fem, sets, study
from sweepopt.cli import main
from sweepopt.integrate import SCHEMES
from sweepopt.io import list_scenes

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```(?:python|\{code-cell\})\n(.*?)^```", re.DOTALL | re.MULTILINE)
WRITTEN = [path for path in sorted(DOCS.rglob("*.md")) if not {"gallery", "site"} & {*path.parts}]
WITH_CODE = [path for path in WRITTEN if BLOCK.search(path.read_text("utf-8"))]
LONG = ("cookbook", "own_finite_elements", "quick_start", "which_scheme")
"""The code of these pages runs in .ci/run, after the fast tests."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The pages of the site in a folder, those that docs/gallery.py makes too."""
    folder = tmp_path_factory.mktemp("site") / "docs"
    made = shutil.ignore_patterns("gallery", "notebooks", "theory.md", "limits.md")
    shutil.copytree(DOCS, folder, ignore=made)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        importlib.import_module("gallery").write_pages(folder)
    return folder


@pytest.mark.parametrize(
    "page", [slow(page) if page.stem in LONG else page for page in WITH_CODE], ids=lambda p: p.stem
)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sweepopt.plot.MOST_FRAMES", 2)  # of animations
    monkeypatch.setattr("sweepopt.fem.pictures.AUTOMATIC", ())
    known = [(some, dict(some)) for some in (fem.EFFECTS, SCHEMES)]
    head, *parts = page.read_text("utf-8").split("\n## ")
    namespace = {}
    try:
        for part in (head, *parts):
            if page.stem == "cookbook":  # each recipe stands alone
                namespace = {}
                part = head + part
            for block in BLOCK.findall(part):
                exec(compile(block, page.name, "exec"), namespace)
    finally:
        plt.close("all")
        for some, before in known:
            for name in some.keys() - before.keys():
                del some[name]
    for line in capsys.readouterr().out.splitlines():
        if "difference" in line:  # from a formula, or from the same set in another form
            assert float(line.split()[-1]) <= 1e-9, line
        elif line.startswith("the same"):
            assert line.endswith("True")


def test_the_pages_with_code_are_those_that_teach():
    teach = {"quick_start", "own_finite_elements", "cookbook", "which_scheme"}
    assert teach <= {page.stem for page in WITH_CODE}


def anchors(page):
    """Names of the headings of a page, as MyST makes them."""
    headings = re.findall(r"^#{1,3} (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def test_links_between_pages_resolve(pages):
    count, scenes = 0, list_scenes()
    for page in pages.rglob("*.md"):
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
            file, _, anchor = target.partition("#")
            if "://" in file or file.removesuffix(".png") in scenes:  # drawn when the site is built
                continue
            count += 1
            assert (page.parent / file).is_file(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(page.parent / file), f"{page.name}: {target}"
    assert count > 40


def test_every_page_and_notebook_is_in_a_table_of_contents(pages):
    listed = set()
    for page in pages.rglob("*.md"):
        for tree in re.findall(r"^```\{toctree\}\n(.*?)```", page.read_text("utf-8"), re.M | re.S):
            names = [line for line in tree.splitlines() if line and not line.startswith(":")]
            listed |= {(page.parent / name.split(" <")[0]).resolve() for name in names}
    files = [*pages.rglob("*.md"), *pages.rglob("*.ipynb")]
    there = {file.with_suffix("") for file in files if not file.stem.endswith("_head")}
    assert listed == there - {pages / "index"}


def test_the_gallery_has_every_scene_with_its_effects_and_its_check(pages):
    for name, title in list_scenes().items():
        page = (pages / "gallery" / f"{name}.md").read_text("utf-8")
        assert f"# {title}\n" in page
        assert f"]({name}.png)" in page  # drawn from a run of the scene when the site is built
        assert re.search(r"\*\*(Checked|Check|Formula)\*\*", page), f"{name}: no check is stated"
        kinds = re.findall(r"~sweepopt\.fem\.(\w+)", page)
        assert len(kinds) >= 2
        assert set(kinds) <= set(fem.__all__)


def test_every_public_name_is_documented_once():
    text = "\n".join(path.read_text("utf-8") for path in (DOCS / "api").glob("*.md"))
    rooms = {"sweepopt": so, "sweepopt.fem": fem, "sweepopt.study": study}
    modules = {**rooms, "sweepopt.sets": sets}
    for block in re.findall(r"\{eval-rst\}\n(.*?)```", text, re.S):
        (module,) = re.findall(r"currentmodule:: (\S+)", block)
        for directive in block.split(".. auto")[1:]:
            name = directive.split()[1]
            for members in re.findall(r":members: (.+)", directive):
                for member in members.split(", "):
                    assert hasattr(getattr(modules[module], name), member), f"{name}.{member}"
    for module, package in rooms.items():
        blocks = re.findall(rf"currentmodule:: {re.escape(module)}\n(.*?)```", text, re.S)
        names = re.findall(r"(?:auto(?:class|function)|py:data):: (\w+)", "\n".join(blocks))
        assert sorted(names) == sorted(package.__all__)


def test_formulas_are_as_tex_reads_them(monkeypatch):
    pytest.importorskip("docutils.utils.math.latex2mathml")
    monkeypatch.syspath_prepend(DOCS)
    mathml = importlib.import_module("mathml").mathml
    half = re.sub(r"\s", "", mathml(r"\tfrac12 x", block=False))
    assert "><mn>1</mn><mn>2</mn></mfrac><mi>x</mi>" in half
    assert "<mtext>(1)</mtext>" in mathml(r"x \le 1 \tag{1}", block=True)
    assert "\\" not in mathml(r"N_{C(t)}\big(A u'\big), \dots", block=True)


def test_commands_on_the_pages_are_understood(pages, capsys):
    text = "\n".join(page.read_text("utf-8") for page in pages.rglob("*.md"))
    commands = {*re.findall(r"`(sweepopt \w[^`]*)`", text)}
    assert len(commands) > 15
    scenes = {*list_scenes(), "SCENE", "STUDY", "STUDY.toml", "NAME"}
    studies = {path.stem for path in (ROOT / "problems").rglob("*.toml")}
    for command in commands:
        _, verb, *words = shlex.split(command)
        with pytest.raises(SystemExit) as stopped:
            main([verb, "--help"])
        assert stopped.value.code == 0, command
        help_text = capsys.readouterr().out
        assert all(word in help_text for word in words if word.startswith("--")), command
        if words and not words[0].startswith("--"):
            assert words[0] in scenes | studies, command


@pytest.mark.skipif("SWEEPOPT_SITE" not in os.environ, reason="SWEEPOPT_SITE names no built site")
def test_a_gallery_page_opens_in_a_browser_and_asks_nobody_for_anything(tmp_path):
    site = Path(os.environ["SWEEPOPT_SITE"]).resolve()
    with chromium(tmp_path) as driver:
        driver.get((site / "gallery" / "index.html").as_uri())
        widths = "return [...document.querySelectorAll('.cards img')].map(i => i.naturalWidth)"
        assert len(driver.execute_script(widths)) == len(list_scenes())
        assert min(driver.execute_script(widths)) > 300
        driver.get((site / "theory.html").as_uri())
        driver.get((site / "gallery" / "tube.html").as_uri())
        assert "Tube pulled through its housing" in driver.find_element("tag name", "h1").text
        driver.get(driver.find_element("link text", "Friction").get_attribute("href"))
        assert driver.find_element("id", "sweepopt.fem.Friction").is_displayed()
        assert driver.current_url.endswith("api/fem.html#sweepopt.fem.Friction")
        assert driver.get_log("browser") == []
        asked = requested(driver)
    assert len(asked) > 10
    assert all(url.startswith((site.as_uri(), "data:")) for url in asked)
