"""A cell of two GP4 that face each other across a plate, as the head of a LEGO scenario."""

from __future__ import annotations

FACING_ARMS = """\
version: 1
name: small
seed: 3
cell:
  robots:
    - {name: left, model: gp4, base: {xyz_m: [0, 0, 0.9246]}}
    - {name: right, model: gp4, base: {xyz_m: [0.88, 0, 0.9246], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [0.7, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}
assembly:
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
"""
