"""A bar that one robot hands to another in the air, as no table is in reach of both."""

BAR = """
version: 1
name: bar
seed: 0
cell:
  robots:
    - {name: left, model: fr3, base: {xyz_m: [-0.6, 0, 0]}, limits: {velocity: 0.8, acceleration: 2.0}}
    - name: right
      model: fr3
      base: {xyz_m: [0.6, 0, 0], rpy_deg: [0, 0, 180]}
      limits: {velocity: 0.8, acceleration: 2.0}
  fixtures:
    - {name: left_table, size_m: [0.5, 0.5, 0.04], pose: {xyz_m: [-0.65, 0.5, -0.02]}}
    - {name: right_table, size_m: [0.5, 0.5, 0.04], pose: {xyz_m: [0.65, 0.5, -0.02]}}
assembly:
  kind: assembly
  approach_m: 0.06
  leave_m: 0.06
  grips: {positions: 3, opening_m: 0.06, depth_m: 0.02, close_s: 0.8, open_s: 0.8}
  parts:
    - {name: a, size_m: [0.2, 0.04, 0.04], start: {xyz_m: [-0.6, 0.45, 0.02]}, goal: {xyz_m: [0.6, 0.45, 0.02]}, mass_kg: 0.08}
  steps: [a]
planning: {speed_model: limits, shortcut_candidates: 1}
"""
