"""Writes the scenario of a generated truss: ``python -m benchmarks.trusses cube-14 > cube.yaml``."""

from __future__ import annotations

import sys

import yaml

from benchmarks.trusses.cell import truss_scenario

if __name__ == "__main__":
    content = truss_scenario(sys.argv[1])
    yaml.safe_dump(content, sys.stdout, sort_keys=False, default_flow_style=None)
