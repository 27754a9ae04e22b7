"""One thread of BLAS a test: `-n 2` runs two at a time, and two threads of each share the cores."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before a worker imports numpy
