"""New Python processes, for none of which a test waits without end."""

import subprocess
import sys
import time
from contextlib import contextmanager

SECONDS = 600  # the longest takes 6 where nothing else runs


def python(*arguments, check=True):
    """What a new Python gave back, which ran this code, or with these arguments."""
    command = [sys.executable, *(arguments if len(arguments) > 1 else ("-c", *arguments))]
    limits = {"stdin": subprocess.DEVNULL, "timeout": SECONDS}
    return subprocess.run(command, capture_output=True, text=True, check=check, **limits)


@contextmanager
def started(ready, *arguments):
    """A new Python when it is ready; it is killed at the end."""
    command = [sys.executable, *arguments]
    quiet = dict.fromkeys(("stdin", "stderr"), subprocess.DEVNULL)
    with subprocess.Popen(command, **quiet) as process:
        try:
            end = time.monotonic() + SECONDS
            while not ready():
                assert process.poll() is None, "it ended early"
                assert time.monotonic() < end, "it is not ready in time"
                time.sleep(0.002)
            yield process
        finally:
            process.kill()
