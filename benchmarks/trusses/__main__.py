"""Writes the scenario of a generated truss: ``python -m benchmarks.trusses cube-14 > cube.yaml``."""

from __future__ import annotations

import sys

import yaml

from benchmarks.trusses.cell import truss_scenario
from benchmarks.trusses.structures import STRUCTURES

if __name__ == "__main__":
    name = sys.argv[1]
    content = truss_scenario(name, STRUCTURES[name]())
    yaml.safe_dump(content, sys.stdout, sort_keys=False, default_flow_style=None)
