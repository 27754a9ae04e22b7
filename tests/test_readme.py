"""What README, CONTRIBUTING and MATH say is true: the example runs, what is named is there."""

import re
from pathlib import Path

from sweepopt.io import list_scenes

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_the_example_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    assert (tmp_path / "run.png").is_file()
    lines = capsys.readouterr().out.splitlines()
    message, state, certificate, bound, viability, program = lines
    assert "every step is certified" in message
    assert state.startswith("[")
    assert float(certificate) <= 1e-6
    number, kind = bound.split()
    assert 0 < float(number) <= 1e-3
    assert kind == "(guaranteed)"
    assert "[" in viability
    assert "QuadForm(z, psd_wrap(M)) + Bu @ z + g @ abs(z)" in program
    assert float(program.split()[-1]) <= 1e-2


def test_it_is_short_and_its_picture_is_there():
    assert len(README.splitlines()) < 120
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).is_file()


def test_the_scenes_are_those_that_the_readme_counts():
    assert "thirteen more scenes" in README
    assert len(list_scenes()) == 13 + 1


def test_what_the_guide_names_is_there():
    guide = (ROOT / "CONTRIBUTING.md").read_text()
    for name in re.findall(r"`((?:\w+/)*\w+(?:\.(?:py|md|toml)|/))`", guide):
        assert (ROOT / name).exists() or any((ROOT / "sweepopt").rglob(name)), name


def test_the_sections_of_the_mathematics_that_the_code_names_are_there():
    sections = re.findall(r"^## (\d)\.", (ROOT / "MATH.md").read_text(), re.MULTILINE)
    sources = "\n".join(file.read_text() for file in (ROOT / "sweepopt").rglob("*.py"))
    named = re.findall(r"MATH(?:\.md\s+section)?\s+(\d)", sources)
    assert len(named) > 5
    assert set(named) <= set(sections)
