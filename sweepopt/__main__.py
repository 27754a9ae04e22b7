"""python -m sweepopt: the command line."""

import sys

from sweepopt.cli import main

if __name__ == "__main__":
    sys.exit(main())
