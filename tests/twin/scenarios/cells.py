"""Cells of these tests, as scenario files: arms around a table, and the assembly that each test adds."""

TABLE = "{name: table, size_m: [1.6, 1.4, 0.02], pose: {xyz_m: [0, 0, -0.01]}}"
GP4S = (
    "{name: left, model: gp4, base: {xyz_m: [0, 0, 0.9246]}}",
    "{name: right, model: gp4, base: {xyz_m: [0.88, 0, 0.9246], rpy_deg: [0, 0, 180]}}",
)
"""Two arms of LEGO cells on either side of a plate."""

ONE_BRICK = """\
version: 1
name: small
cell:
  robots:
    - {name: left, model: gp4, base: {xyz_m: [0, 0, 0.9246]}}
    - {name: right, model: gp4, base: {xyz_m: [1, 0, 0.9246]}}
assembly:
  kind: lego
  plate: {pose: {xyz_m: [0.4, 0, 1.1145]}}
  stock:
    - {name: b1, brick: 2x4, at: [4, 24, 1]}
  steps:
    - {brick: 2x4, at: [24, 24, 1]}
"""
"""Two arms and a brick, as a file of its own."""


def panda(name: str, at: float, more: str = "") -> str:
    """Return a Panda that looks to the middle of the cell, from so far along x."""
    turned = ", rpy_deg: [0, 0, 180]" if at > 0 else ""
    return (
        f"{{name: {name}, model: panda, base: {{xyz_m: [{at}, 0, 0]{turned}}}{more}}}"
    )


def cell(
    name: str, robots: tuple[str, ...], assembly: str, *fixtures: str, tools: str = ""
) -> str:
    """Return a scenario file: robots and fixtures, a line each, and whatever comes after them."""
    lines = ["version: 1", f"name: {name}", "cell:"]
    lines += ["  robots:", *(f"    - {robot}" for robot in robots)]
    lines += ["  fixtures:", *(f"    - {fixture}" for fixture in fixtures or (TABLE,))]
    return "\n".join(lines) + f"\n{tools}assembly:\n{assembly}"
