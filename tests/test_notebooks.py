"""The notebooks run from top to bottom, and show what the code that is here prints.

`python tests/test_notebooks.py --write` runs them and stores their outputs; names of notebooks
after it restrict it to these.

Text is compared word by word, numbers to 5 per cent; below 1e-6 they are what solvers leave and
rounding. Of a cell with the tag "timings" the words are compared, in any order, and no numbers; of
one with the tag "fastest", whose words depend on the speed of the machine, the number of lines.
Versions of cvxpy print programs in their own ways: nothing is compared with what another stored.
"""

import re
import sys
from collections import Counter
from importlib.metadata import version
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\w])", re.IGNORECASE)
CLOSE = {"rel": 0.05, "abs": 1e-6}
CVXPY = ".".join(version("cvxpy").split(".")[:2])
RESET = """
import gc
import warnings
import matplotlib.pyplot
gc.freeze()  # a study collects garbage before each cell
matplotlib.pyplot.close("all")
matplotlib.rcdefaults()
warnings.filters[:] = vars(warnings).setdefault("filters_of_the_start", list(warnings.filters))
get_ipython().run_line_magic("reset", "-f")
get_ipython().run_line_magic("matplotlib", "inline")
get_ipython().run_line_magic("config", "InlineBackend.print_figure_kwargs = dict(bbox_inches=None)")
"""


def execute(notebook, kernel):
    import nbclient  # as the two below, for slow tests alone

    settings = {"timeout": 300, "kernel_name": "python3", "record_timing": False}
    client = nbclient.NotebookClient(notebook, km=kernel, **settings)
    try:
        client.execute()
    finally:
        if kernel is not None:
            client.kc.stop_channels()


def run(path, kernel=None):
    """The notebook as it is stored, and as it comes out now; in a new kernel if none is given."""
    import nbformat

    stored, fresh = (nbformat.read(path, as_version=4) for _ in range(2))
    if kernel is not None:
        execute(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(RESET)]), kernel)
    execute(fresh, kernel)
    fresh.metadata["cvxpy"] = CVXPY
    return stored, fresh


def text(cell):
    """What a cell printed, and the value it shows if that is no picture."""
    shown = []
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        if output.get("name") == "stdout":
            shown.append(output["text"])
        elif "text/plain" in data and "image/png" not in data:
            shown.append(data["text/plain"] + "\n")
    return re.sub(r"0x[0-9a-f]+", "", "".join(shown))


def pictures(cell):
    return sum("image/png" in output.get("data", {}) for output in cell.get("outputs", []))


def same_text(old, new, tags):
    if "fastest" in tags:
        # which runs are the best ones depends on the time that they take
        tables = [shown.strip().split("\n\n") for shown in (old, new)]
        assert len(tables[0]) == len(tables[1])
        assert len(tables[0][0].splitlines()) == len(tables[1][0].splitlines())
        assert tables[0][-1].splitlines()[-1] == tables[1][-1].splitlines()[-1]
        return
    words = [NUMBER.sub("#", shown).split() for shown in (old, new)]
    if "timings" in tags:
        assert Counter(words[0]) == Counter(words[1])
        return
    assert words[0] == words[1]
    numbers = [[float(x) for x in NUMBER.findall(shown)] for shown in (old, new)]
    assert numbers[1] == pytest.approx(numbers[0], **CLOSE)


@pytest.fixture(scope="module")
def kernel():
    """One kernel for all notebooks, which forgets names, figures and filters of warnings between
    them: a new one for each would import everything again, half of the time of these tests.
    """
    import jupyter_client

    manager = jupyter_client.KernelManager(kernel_name="python3")
    manager.start_kernel()
    yield manager
    manager.shutdown_kernel(now=True)
    manager.cleanup_resources()


@pytest.mark.slow  # .ci/run runs them
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_notebook_shows_what_the_code_prints(path, kernel):
    stored, fresh = run(path, kernel)
    assert any(text(cell) or pictures(cell) for cell in stored.cells)
    if stored.metadata["cvxpy"] != CVXPY:
        pytest.skip(f"it runs; what it shows was stored with cvxpy {stored.metadata['cvxpy']}")
    for old, new in zip(stored.cells, fresh.cells, strict=True):
        assert pictures(old) == pictures(new)
        same_text(text(old), text(new), old.metadata.get("tags", []))


def test_texts_that_differ_are_told_apart():
    same_text("error 2.00e-04, 3 steps", "error 2.01e-04, 3 steps", [])
    same_text("certificate 3.1e-15", "certificate 4.0e-09", [])
    same_text("scs 2.1 ms\nosqp 1 ms", "osqp 7 ms\nscs 3 ms", ["timings"])
    for old, new, tags in (
        ("error 2.00e-04", "error 2.40e-04", []),
        ("order 2", "order 1", []),
        ("scheme midpoint", "scheme sdirk2", []),
        ("scs 2.1 ms", "scs 2.1 ms failed", ["timings"]),
        ("a\nb", "a", ["fastest"]),
        ("a\n\n7 cells", "a\n\n8 cells", ["fastest"]),
    ):
        with pytest.raises(AssertionError):
            same_text(old, new, tags)


if __name__ == "__main__":
    if sys.argv[1:2] != ["--write"]:
        sys.exit(__doc__)
    import nbformat

    for notebook in NOTEBOOKS:
        if notebook.stem in (sys.argv[2:] or notebook.stem):
            nbformat.write(run(notebook)[1], notebook)
            print("stored", notebook.name)
