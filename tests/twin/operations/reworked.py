"""A cover that two arms work at several times, and that is then inspected."""

from tests.twin.scenarios.cells import cell, panda

_TOOL = ", frames: {driver: {xyz_m: [0, 0, 0.114]}}"

BIN = {"fixture": "crate", "pose": {"xyz_m": [0, 0, 0.2]}}
"""A bin over a crate that the left arm reaches."""

_CRATE = "{name: crate, size_m: [0.2, 0.2, 0.05], pose: {xyz_m: [-0.7, 0.35, 0.025]}}"


def with_crate(text: str) -> str:
    """Return a scenario with a crate beside the left arm."""
    head, rest = text.split("  fixtures:\n")
    return f"{head}  fixtures:\n    - {_CRATE}\n{rest}"


REWORKED = cell(
    "reworked",
    (panda("left", -0.55, _TOOL), panda("right", 0.55, _TOOL)),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - name: cover
      size_m: [0.16, 0.036, 0.02]
      start: {xyz_m: [-0.3, 0.3, 0.01]}
      goal: {xyz_m: [0, 0, 0.05]}
      frames:
        hole1: {xyz_m: [-0.05, 0, 0.01]}
        hole2: {xyz_m: [0.05, 0, 0.01]}
        middle: {xyz_m: [0, 0, 0.01]}
    - name: pin
      size_m: [0.03, 0.03, 0.06]
      start: {xyz_m: [-0.3, -0.3, 0.03]}
      goal: {xyz_m: [0.06, 0.04, 0.07]}
  processes:
    clean: {duration: {kind: fixed, value_s: 1}, frame: driver}
    screw: {duration: {kind: fixed, value_s: 2}, frame: driver}
    inspect: {duration: {kind: fixed, value_s: 1}, frame: driver}
  steps:
    - {process: clean, at: {part: cover, frame: middle}, name: cleaned, robots: [left]}
    - {place: cover, after: [cleaned], name: covered}
    - {process: screw, at: {part: cover, frame: hole1}, robots: [left], after: [covered], name: first}
    - {process: screw, at: {part: cover, frame: hole2}, robots: [right], after: [first], name: second}
    - {process: clean, at: {part: cover, frame: middle}, robots: [right], after: [second], name: third}
    - {process: inspect, at: {part: cover, frame: middle}, robots: [left], after: [third], name: seen}
    - {place: pin, robots: [left], after: [seen]}
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: fixed, value_s: 1.5}
    place-down: {kind: fixed, value_s: 1.5}
""",
    "{name: table, size_m: [1.6, 1.2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}",
    "{name: jig, size_m: [0.18, 0.12, 0.04], pose: {xyz_m: [0, 0, 0.02]}}",
)
