"""One thread of BLAS a test: `-n 2` runs two at a time, and two threads of each share the cores."""

import faulthandler
import gc
import os
import sys

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before a worker imports numpy
gc.disable()  # nothing that is imported is freed: looking for it took a quarter of the collection


def pytest_collection_finish():
    """What is imported by now stays: the garbage collector need not look at it again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def _full_sizes_take_their_time(request):
    """The limit of a test's time (pyproject.toml) is not for those that are marked slow."""
    if request.node.get_closest_marker("slow"):
        faulthandler.cancel_dump_traceback_later()


@pytest.fixture(autouse=True)
def _figures_are_closed():
    """pyplot keeps every figure, and warns of the 21st."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
