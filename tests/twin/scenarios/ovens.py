"""A small line for tests: one arm bakes blanks, two at a time, in an oven with a door."""

OVEN = """\
version: 1
name: oven
cell:
  robots:
    - {name: arm, model: panda, base: {xyz_m: [-0.6, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.8, 1.3, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - name: rack
      size_m: [0.16, 0.1, 0.04]
      pose: {xyz_m: [-0.2, 0.3, 0.02]}
      frames: {nest: {xyz_m: [-0.04, 0, 0.02]}}
assembly:
  kind: assembly
  sources:
    blanks: {kind: feeder, pose: {xyz_m: [-0.35, -0.33, 0.015]}, refill_s: 2.0}
  machines:
    oven: {capacity: 2, fixtures: [rack], door: {size_m: [0.3, 0.01, 0.3], pose: {xyz_m: [-0.2, 0.2, 0.2]}}}
  processes:
    baking: {duration: {kind: uniform, low_s: 5.0, high_s: 60.0}, machine: oven}
  parts:
    - {name: blank, size_m: [0.03, 0.03, 0.03], source: blanks, goal: {xyz_m: [0.0, -0.2, 0.015]}}
  steps:
    - place: blank
      at: {fixture: rack, frame: nest, pose: {xyz_m: [0, 0, 0.015]}, grid: {counts: [2, 1], pitch_m: [0.08, 0]}}
    - {process: baking, at: {part: blank}, name: baked}
    - {place: blank, after: [baked]}
  products: {count: 4, leave_s: 1.0}
  grips: {opening_m: 0.04, positions: 1}
planning: {speed_rad_s: 2.0, shortcut_candidates: 30}
execution:
  skills: {pick: {kind: fixed, value_s: 1.0}, place-down: {kind: fixed, value_s: 1.0}}
"""
