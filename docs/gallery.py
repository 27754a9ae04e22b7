"""Pages that are made from other files of the repository, when Sphinx starts.

The gallery has a page for each scene of problems/: its title, comment, effects and file, and a
picture of a run of it (all fourteen runs take half a minute; a picture is kept until the data of
its scene change). theory.md and limits.md have the text of MATH.md and of README.md.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
import shutil
import tomllib
from itertools import groupby
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
SCENES = {path.stem: path for path in sorted((ROOT / "problems").glob("*.toml"))}
WORDS = "Seen|Checked|Check|Formula|Optional|Source|Values"  # that begin a paragraph


def checksum(name: str) -> str:
    """Of the scene's data, whatever its comments say."""
    data = tomllib.loads(SCENES[name].read_text("utf-8"))
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]


def comment(text: str) -> str:
    """The full-line comments above [domain] as Markdown; indented lines are formulas."""
    lines = [line[1:] for line in text.split("\n[domain]")[0].splitlines() if line.startswith("#")]
    parts: list[str] = []
    for formula, group in groupby(lines, lambda line: line.startswith("    ")):
        if formula:
            parts.append("\n".join(group))
            continue
        for paragraph in "\n".join(line.strip() for line in group).split("\n\n"):
            plain = re.sub(r"([<>*_|$])", r"\\\1", paragraph)
            parts += re.split(rf"(?:^|(?<=[.:!]\s))(?=(?:{WORDS})\b)", plain)
    parts = [re.sub(rf"^({WORDS})\b", r"**\1**", part) for part in parts if part.strip()]
    return "\n\n".join(part if part.startswith("    ") else part.strip() for part in parts)


def toml(value: Any) -> str:
    """A value as a scene file may have it."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml(one)}' for key, one in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)


def effect_rows(effects: dict[str, Any]) -> list[str]:
    """A row of a table for each effect: the class that has its keys, and its values."""
    from sweepopt.fem import EFFECTS

    rows = []
    for name, tables in effects.items():
        kind = EFFECTS[name].__name__
        for table in tables if isinstance(tables, list) else [tables]:
            values = ", ".join(f"`{key} = {toml(value)}`" for key, value in table.items())
            rows.append(f"| `{name}` ({{py:class}}`~sweepopt.fem.{kind}`) | {values} |")
    return rows


def page(name: str) -> str:
    """The page of a scene, in Markdown."""
    text = SCENES[name].read_text("utf-8")
    data = tomllib.loads(text)
    domain = data["domain"]
    body = f"{domain.get('kind', 'antiplane')}, {data.get('units', 'dimensionless')}"
    parts = [
        f"# {data['title']}",
        f"`sweepopt run {name}` ({body})",
        f"![{data['title']}]({name}.png)",
        comment(text),
        "\n".join(["| effect | values |", "|---|---|", *effect_rows(data["effects"])]),
        f"## The file\n\n```{{literalinclude}} ../../problems/{name}.toml\n:language: toml\n```\n",
    ]
    return "\n\n".join(part for part in parts if part)


def index() -> str:
    """The page that shows all of them."""
    cards = [
        f"[![]({name}.png)]({name}.md) **{name}** {tomllib.loads(path.read_text('utf-8'))['title']}"
        for name, path in SCENES.items()
    ]
    shown, names = "\n\n".join(cards), "\n".join(f"{name} <{name}>" for name in SCENES)
    return (DOCS / "gallery_head.md").read_text("utf-8") + (
        f"\n:::{{container}} cards\n{shown}\n:::\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )


def test_problems() -> str:
    """A table of the small problems of the studies."""
    from sweepopt.study.problems import PROBLEMS

    rows = [f"| {name} | {one.title} | {one.t_end:g} |" for name, one in PROBLEMS.items()]
    return "\n".join(["| name | problem | t_end |", "|---|---|---|", *rows, ""])


def write_pages(folder: Path = DOCS) -> None:
    """All pages that are made from other files; none of them is in git."""
    mathematics, readme = ((ROOT / name).read_text("utf-8") for name in ("MATH.md", "README.md"))
    limits = readme.partition("\n## Limits\n")[2].partition("\n`MATH.md`")[0].partition("\n## ")[0]
    made = {
        "theory.md": mathematics,
        "limits.md": (DOCS / "limits_head.md").read_text("utf-8") + literal(limits),
        "test_problems.md": (DOCS / "test_problems_head.md").read_text("utf-8") + test_problems(),
        "gallery/index.md": index(),
        **{f"gallery/{name}.md": page(name) for name in SCENES},
    }
    for name, text in made.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text("utf-8") != text:  # Sphinx reads what has changed
            path.write_text(text, "utf-8")
    (folder / "notebooks").mkdir(exist_ok=True)
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        shutil.copy2(notebook, folder / "notebooks")


def draw_pictures(app: Any) -> None:
    """The first picture of each scene, with the checksum of its data beside it."""
    from sphinx.util.display import status_iterator

    from sweepopt.fem import read_scene

    logging.getLogger("skfem").setLevel(logging.WARNING)
    folder = DOCS / "gallery"
    for name in status_iterator(SCENES, "drawing scenes... ", length=len(SCENES)):
        picture, drawn = folder / f"{name}.png", folder / f"{name}.sha"
        if not (drawn.exists() and drawn.read_text() == checksum(name)):
            scene = read_scene(SCENES[name])
            scene.plot(scene.solve()).savefig(picture, dpi=90)
            drawn.write_text(checksum(name))


def literal(text: str) -> str:
    """Text whose |z|_A and <Az, z> mean themselves, outside of code."""
    pieces = re.split(r"(`[^`\n]*`|^    .*$)", text, flags=re.M)
    escaped = (re.sub(r"(?<=\|)_|<(?=[A-Za-z])|\$", r"\\\g<0>", piece) for piece in pieces)
    return "".join(pieces[k] if k % 2 else text for k, text in enumerate(escaped))


def setup(app: Any) -> dict[str, Any]:
    """What Sphinx calls."""
    app.connect("builder-inited", lambda _: write_pages())
    app.connect("builder-inited", draw_pictures)
    return {"parallel_read_safe": True}
