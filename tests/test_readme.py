"""What the README shows is true: its example runs, its two commands are those of CI."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_the_example_runs_and_prints_what_it_says(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    message, state, certificate, bound, viability = capsys.readouterr().out.splitlines()
    assert "every step is certified" in message
    assert state.startswith("[")
    assert float(certificate) <= 1e-6
    assert 0 < float(bound) <= 1e-3
    assert "[" in viability


def test_the_scene_shown_is_the_tube_with_fewer_effects() -> None:
    (shown,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    tube = (ROOT / "problems" / "tube.toml").read_text()
    for line in shown.splitlines():
        assert line.split("#")[0].strip() in tube


def test_it_is_short_and_its_picture_is_there() -> None:
    assert len(README.splitlines()) < 150
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).is_file()
