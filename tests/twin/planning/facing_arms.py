"""A cell of two GP4 that face each other across a plate, as the head of a LEGO scenario."""

from tests.twin.scenarios.cells import GP4S, cell

FACING_ARMS = cell(
    "small",
    GP4S,
    """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
""",
    "{name: table, size_m: [0.7, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}",
).replace("cell:", "seed: 3\ncell:")
