"""Runs the experiments; see ``experiments``."""

from __future__ import annotations

import sys

from benchmarks.construction.experiments import main

if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on from here\n")
        sys.exit(130)
