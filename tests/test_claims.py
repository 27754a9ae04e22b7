"""What README.md and MATH.md say, and the test or the study that shows it.

claims.toml has words of each claim as they stand in the document, and what shows it: names of tests
(of laws in laws.py), a file that prints it, or a list of tests and of calls that data/refused.txt
has. A claim that is reworded, a test or call that is gone and a point of a list or row of a table
that nothing shows make a test fail here.
"""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

CLAIMS = tomllib.loads((Path(__file__).parent / "claims.toml").read_text())


def points(document):
    """The points of lists and the rows of tables, but for their headings, a line each."""
    text = re.sub(r"```.*?```", "", (ROOT / document).read_text(), flags=re.DOTALL)
    text = re.sub(r"^\|.*\n\|[-|]+\|$", "", text, flags=re.MULTILINE)
    for block in re.split(r"\n\s*\n|\n(?=[*|] ?)", text):
        if block.strip()[:2] in ("* ", "| "):
            yield " ".join(block.split())


def plain(document):
    return " ".join((ROOT / document).read_text().replace("**", "").split())


@pytest.mark.parametrize("document", CLAIMS)
def test_every_point_of_a_list_and_row_of_a_table_has_a_claim_that_is_shown(document):
    bare = [point for point in points(document) if not any(x in point for x in CLAIMS[document])]
    assert not bare
    assert len(list(points(document))) > 15


@pytest.mark.parametrize("document", CLAIMS)
def test_the_claims_are_what_the_document_says(document):
    assert not [claim for claim in CLAIMS[document] if claim not in plain(document)]


def test_what_shows_a_claim_is_there():
    tests = "\n".join(path.read_text() for path in Path(__file__).parent.glob("*.py"))
    known = set(re.findall(r"^def (\w+)\(", tests, re.MULTILINE))
    known |= set((Path(__file__).parent / "data" / "refused.txt").read_text().splitlines())
    shown = {
        name
        for claims in CLAIMS.values()
        for names in claims.values()
        for name in (names.split() if isinstance(names, str) else names)
    }
    assert not [name for name in shown - known if not (ROOT / name).is_file()]
