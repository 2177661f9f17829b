"""Numbers that are far from what is usual: sixty absurd cells, each beside a sane neighbour, and the table itself."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.twin.scenarios.test_hairs_breadth import CELL
from tests.twin.written import Change, written
from twin.checks.check import findings_without_reach
from twin.checks.finding import CheckContext
from twin.checks.meshes import check_meshes
from twin.checks.usual import (
    USUAL,
    check_physics,
    check_rates,
    check_usual,
    usual_range,
)
from twin.document.section import Section
from twin.reading.scenario_file import read_scenario

ROOT = Path(__file__).parents[3]

LINE: tuple[Change, ...] = (
    ("  - {place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.05]}}}\n    - {process: bake, at: {part: puck}}\n    ", "  "),
    ("start: {xyz_m: [-0.25, -0.3, 0.04]}", "source: blocks"),
    ("start: {xyz_m: [0.25, -0.3, 0.02]}", "source: bars"),
    ("start: {xyz_m: [0.0, -0.4, 0.03]}", "source: pucks"),
    (
        "  machines: {oven: {fixtures: [anvil]}}\n",
        "  leave_m: 0.1\n"
        "  sources:\n"
        "    blocks: {kind: conveyor, pose: {xyz_m: [-0.25, -0.3, 0.04]}, every_s: 30, buffer: 3, advance_s: 2}\n"
        "    bars: {kind: feeder, pose: {xyz_m: [0.25, -0.3, 0.02]}, refill_s: 3}\n"
        "    pucks: {kind: feeder, pose: {xyz_m: [0.0, -0.4, 0.03]}}\n"
        "  products: {count: 4, leave_s: 1, due: {first_s: 120, every_s: 90}}\n",
    ),
    ("    bake: {duration: {kind: fixed, value_s: 20}, machine: oven}\n", ""),
)  # fmt: skip
"""The bench as a line."""

WITHIN = (("speed_model: joint", "speed_model: limits"),)
OWN_TIMES = (
    (
        "execution:\n  skills: {pick: {kind: fixed, value_s: 2}, place-down: {kind: fixed, value_s: 2}}\n",
        "",
    ),
)

EXECUTION = "execution:\n"
PLANNING = "planning: {speed_model: joint}"
LIMITS = "limits: {payload_kg: 5}}\n    - {name: east"


def execution(absurd: str, sane: str) -> tuple[str, str, str]:
    return EXECUTION, f"execution:\n  {absurd}\n", f"execution:\n  {sane}\n"


def planning(absurd: str, sane: str) -> tuple[str, str, str]:
    return PLANNING, f"{PLANNING[:-1]}, {absurd}}}", f"{PLANNING[:-1]}, {sane}}}"


def limits(absurd: str, sane: str) -> tuple[str, str, str]:
    head, tail = "limits: {payload_kg: 5, ", "}}\n    - {name: east"
    return LIMITS, f"{head}{absurd}{tail}", f"{head}{sane}{tail}"


def instead(of: str, absurd: str, sane: str) -> tuple[str, str, str]:
    return of, absurd, sane


PICK = "pick: {kind: fixed, value_s: 2}"
FAILURES = "failures: {{pick: {{{}}}}}"

PAIRS: dict[str, tuple[str, tuple[str, str, str], tuple[Change, ...]]] = {
    # Robots and tools.
    "joints as fast as a drill": ("limits.velocity", limits("velocity: 60", "velocity: 3"), ()),
    "joints slower than a clock": ("limits.velocity", limits("velocity: 0.002", "velocity: 0.5"), ()),
    "twice and a half what the maker says": ("2.5", limits("velocity: 7.854", "velocity: 4"), ()),
    "accelerations of a bullet": ("acceleration", limits("acceleration: 90000", "acceleration: 20"), ()),
    "accelerations of a glacier": ("acceleration", limits("acceleration: 0.001", "acceleration: 0.5"), ()),
    "a jerk of a hammer": ("jerk", limits("jerk: 1000000", "jerk: 300"), ()),
    "efforts of a toy": ("effort", limits("effort: 0.01", "effort: 200"), ()),
    "a payload in grams": ("payload_kg", instead(LIMITS, LIMITS.replace("5", "5000"), LIMITS.replace("5", "12")), ()),
    "a tool as fast as a car": ("tool_speed_m_s", limits("tool_speed_m_s: 40", "tool_speed_m_s: 1.5"), WITHIN),
    "a loaded tool that creeps": ("loaded_tool_speed_m_s", limits("loaded_tool_speed_m_s: 0.002", "loaded_tool_speed_m_s: 0.25"), WITHIN),
    "a repeatability in millimetres": ("repeatability_m", instead("tool: jaws, base: {xyz_m: [-0.55", "tool: jaws, repeatability_m: 0.05, base: {xyz_m: [-0.55", "tool: jaws, repeatability_m: 0.00005, base: {xyz_m: [-0.55"), ()),
    "a base that is anywhere": ("base_error", instead("tool: jaws, base: {xyz_m: [-0.55", "tool: jaws, base_error: {m: 0.08}, base: {xyz_m: [-0.55", "tool: jaws, base_error: {m: 0.002}, base: {xyz_m: [-0.55"), ()),
    "a gripper that crushes": ("force_n", instead("opening_m: 0.08\n", "opening_m: 0.08\n      force_n: 500000\n", "opening_m: 0.08\n      force_n: 120\n"), ()),
    "a gripper that breathes": ("force_n", instead("opening_m: 0.08\n", "opening_m: 0.08\n      force_n: 0.01\n", "opening_m: 0.08\n      force_n: 60\n"), ()),
    "a gripper of a crane": ("mass_kg", instead("mass_kg: 0.9\n    cup", "mass_kg: 900\n    cup", "mass_kg: 1.4\n    cup"), ()),
    "fingers that close in an hour": ("close_s", instead("opening_m: 0.08\n", "opening_m: 0.08\n      close_s: 3600\n", "opening_m: 0.08\n      close_s: 0.4\n"), OWN_TIMES),
    "fingers that open in a microsecond": ("open_s", instead("opening_m: 0.08\n", "opening_m: 0.08\n      open_s: 0.000001\n", "opening_m: 0.08\n      open_s: 0.1\n"), OWN_TIMES),
    "pads a metre wide": ("finger_width_m", instead("depth_m: 0.02}", "depth_m: 0.02, finger_width_m: 0.9}", "depth_m: 0.02, finger_width_m: 0.03}"), ()),
    "a robot that hangs below the floor": ("upside down", instead("base: {xyz_m: [-0.55, 0, 0]}", "base: {xyz_m: [-0.55, 0, -1.2], rpy_deg: [180, 0, 0]}", "base: {xyz_m: [-0.55, 0, 0], rpy_deg: [0, 0, 20]}"), ()),
    "clearances of half the cell": ("robot_robot_m", instead("  robots:\n", "  clearance: {robot_robot_m: 0.5}\n  robots:\n", "  clearance: {robot_robot_m: 0.02}\n  robots:\n"), ()),
    # Bodies and contacts.
    "a puck of a neutron star": ("kg/m^3", instead("mass_kg: 0.3}", "mass_kg: 4.9}", "mass_kg: 0.9}"), ()),
    "a bar lighter than air": ("kg/m^3", instead("mass_kg: 0.9, frames", "mass_kg: 0.0001, frames", "mass_kg: 0.01, frames"), ()),
    "a stuff heavier than osmium": ("density_kg_m3", instead("mass_kg: 0.3}", "density_kg_m3: 30000}", "density_kg_m3: 7800}"), ()),
    "a stuff lighter than foam": ("density_kg_m3", instead("mass_kg: 0.3}", "density_kg_m3: 1}", "density_kg_m3: 40}"), ()),
    "glue for friction": ("friction", instead("joined: [[", "balance: {friction: 6}\n  joined: [[", "balance: {friction: 0.9}\n  joined: [["), ()),
    "ice on ice": ("friction", instead("joined: [[", "balance: {friction: 0.001}\n  joined: [[", "balance: {friction: 0.2}\n  joined: [["), ()),
    "a floor as steep as a roof": ("tilt_deg", instead("joined: [[", "balance: {tilt_deg: 40}\n  joined: [[", "balance: {tilt_deg: 2}\n  joined: [["), ()),
    "a joint that bears a mountain": ("force_n", instead("[[block, bar]]", "[{parts: [block, bar], force_n: 900000000}]", "[{parts: [block, bar], force_n: 900}]"), ()),
    "a joint that bears a feather": ("torque_nm", instead("[[block, bar]]", "[{parts: [block, bar], torque_nm: 0.00001}]", "[{parts: [block, bar], torque_nm: 4}]"), ()),
    "an open mesh": ("is open", instead("puck, shape: {cylinder: {radius_m: 0.025, length_m: 0.06}}", "puck, shape: {mesh: open.stl}", "puck, shape: {mesh: closed.stl}"), ()),
    "a mesh with one window": ("is open", instead("puck, shape: {cylinder: {radius_m: 0.025, length_m: 0.06}}", "puck, shape: {mesh: window.stl}", "puck, shape: {mesh: crack.stl}"), ()),
    # Steps and processes.
    "a way in of two metres": ("approach_m", instead("  grips: {depth", "  approach_m: 0.9\n  grips: {depth", "  approach_m: 0.1\n  grips: {depth"), ()),
    "a way out of a hair": ("leave_m", instead("  grips: {depth", "  leave_m: 0.0002\n  grips: {depth", "  leave_m: 0.04\n  grips: {depth"), ()),
    "a camera in the next hall": ("distance_m", instead("frame: tool}", "frame: tool, distance_m: 9}", "frame: tool, distance_m: 0.3}"), ()),
    "a tap that takes a week": ("mean of tap.duration", instead("value_s: 2}, frame", "value_s: 600000}, frame", "value_s: 45}, frame"), ()),
    "baked for a nanosecond": ("mean of bake.duration", instead("value_s: 20}", "value_s: 0.000000001}", "value_s: 3600}"), ()),
    "a pick in a day": ("mean of skills.pick", instead(PICK, PICK.replace("2}", "86400}"), PICK.replace("2}", "9}")), ()),
    "a pick in a millisecond": ("mean of skills.pick", instead(PICK, PICK.replace("2}", "0.001}"), PICK.replace("2}", "0.9}")), ()),
    "a pick that scatters without end": ("cv", instead(PICK, "pick: {kind: lognormal, mean_s: 2, cv: 300}", "pick: {kind: lognormal, mean_s: 2, cv: 0.4}"), ()),
    "times a thousand times as long": ("scale", instead(PICK, PICK.replace("2}", "2, scale: 200}"), PICK.replace("2}", "2, scale: 1.3}")), ()),
    # Lines.
    "a part a month": ("every_s", instead("every_s: 30,", "every_s: 900000,", "every_s: 60,"), LINE),
    "a thousand parts a second": ("every_s", instead("every_s: 30,", "every_s: 0.001,", "every_s: 4,"), LINE),
    "a belt that waits for days": ("advance_s", instead("advance_s: 2", "advance_s: 200000", "advance_s: 12"), LINE),
    "a feeder that is filled in years": ("refill_s", instead("refill_s: 3", "refill_s: 900000", "refill_s: 300"), LINE),
    "products that leave in a fortnight": ("leave_s", instead("leave_s: 1,", "leave_s: 900000,", "leave_s: 30,"), LINE),
    "due before it can begin": ("first_s", instead("first_s: 120", "first_s: 0.01", "first_s: 60"), LINE),
    "due within the same second": ("every_s", instead("every_s: 90}", "every_s: 0.0001}", "every_s: 20}"), LINE),
    "due the other way round": ("before product", instead("{first_s: 120, every_s: 90}", "[90, 200, 150, 300]", "[90, 150, 150, 300]"), LINE),
    # Execution.
    "reports by mail": ("report_latency_s", execution("report_latency_s: 900", "report_latency_s: 0.02"), ()),
    "releases by mail": ("release_latency_s", execution("release_latency_s: 40", "release_latency_s: 0.1"), ()),
    "stalls for half of the time": ("stand still", execution("stalls: {rate_per_h: 60, duration_s: [100, 200]}", "stalls: {rate_per_h: 6, duration_s: [10, 20]}"), ()),
    "stalls every second": ("rate_per_h", execution("stalls: {rate_per_h: 3600, duration_s: [0.1, 0.2]}", "stalls: {rate_per_h: 30, duration_s: [0.1, 0.2]}"), ()),
    "a thousand stalls at once": ("count_per_robot", execution("stalls: {count_per_robot: 50000}", "stalls: {count_per_robot: 2}"), ()),
    "repairs longer than work": ("mttr_s", execution("breakdowns: {mtbf_s: 600, mttr_s: 900}", "breakdowns: {mtbf_s: 36000, mttr_s: 900}"), ()),
    "broken every second": ("mtbf_s", execution("breakdowns: {mtbf_s: 2, mttr_s: 1}", "breakdowns: {mtbf_s: 7200, mttr_s: 60}"), ()),
    "picks that nearly always fail": ("probability", execution(FAILURES.format("probability: 0.98"), FAILURES.format("probability: 0.05")), ()),
    "nine hundred retries": ("retries", execution(FAILURES.format("probability: 0.1, retries: 900"), FAILURES.format("probability: 0.1, retries: 4")), ()),
    "arms at a hundredth of their speed": ("value", execution("speed: {factor: {kind: fixed, value: 0.005}}", "speed: {factor: {kind: fixed, value: 0.7}}"), ()),
    "a stop of a month": ("duration_s", execution("emergency_stops: [{at_s: 5, duration_s: 900000}]", "emergency_stops: [{at_s: 5, duration_s: 60}]"), ()),
    "an hour to plan anew": ("planning_s", execution("recovery: {planning_s: 3500}", "recovery: {planning_s: 5}"), ()),
    "a person who cannot help": ("helps", execution("recovery: {ask: {helps: 0.001}}", "recovery: {ask: {helps: 0.7}}"), ()),
    # Planning.
    "motions looked at every ten seconds": ("step_s", planning("step_s: 9", "step_s: 0.1"), ()),
    "ten million shortcuts": ("shortcut_candidates", planning("shortcut_candidates: 9000000", "shortcut_candidates: 2000"), ()),
}  # fmt: skip
"""By what is absurd: what is told of it, what stands in the bench, the absurd and the sane, and what else is changed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with meshes: closed, with a crack that has no area, with a window, and half of one."""
    out = tmp_path_factory.mktemp("usual")
    whole = trimesh.creation.cylinder(0.025, 0.06, sections=24)
    whole.export(out / "closed.stl")
    half = whole.copy()
    half.update_faces(half.triangles_center[:, 0] > -0.001)
    half.export(out / "open.stl")
    window = whole.copy()
    window.update_faces(np.arange(len(window.faces)) != np.argmax(window.area_faces))
    window.export(out / "window.stl")
    split(whole).export(out / "crack.stl")
    return out


def split(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Cut one triangle in two whose neighbour is not cut: its edge is two of others."""
    a, b, c = mesh.faces[0]
    middle = len(mesh.vertices)
    vertices = np.vstack([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0)])
    faces = np.vstack([mesh.faces[1:], [[a, middle, c], [middle, b, c]]])
    return trimesh.Trimesh(vertices, faces, process=False)


def bench(folder: Path, *changes: Change) -> CheckContext:
    return CheckContext(read_scenario(written(folder, CELL, *changes))[0], folder)


CHECKS = check_usual, check_rates, check_physics, check_meshes


def test_there_are_sixty() -> None:
    assert len(PAIRS) >= 60


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=[pytest.mark.nightly] if k % 3 == 2 else [])
        for k, what in enumerate(PAIRS)
    ],
)
def test_what_is_absurd_is_told_and_its_neighbour_is_not(
    what: str, folder: Path
) -> None:
    says, (old, absurd, sane), besides = PAIRS[what]
    subject = bench(folder, *besides, (old, absurd))
    found = [item.message for check in CHECKS for item in check(subject)]
    if not any(says in message for message in found):
        # By a check of the kind of assembly.
        found += [item.message for item in findings_without_reach(subject)]
    assert any(says in message for message in found), found
    assert findings_without_reach(bench(folder, *besides, (old, sane))) == []


ANY = {
    "PlateSection": "studs", "BrickSection": "studs height bare", "BrickStepSection": "at raised attack colour",
    "StockSection": "at raised", "StructureBrickSection": "at raised colour", "StructureSection": "origin",
    "SupportSection": "at raised orientation", "PressSection": "side offset", "PressCellSection": "at raised",
    "ElevationSection": "at depth", "RulesSection": "plinth", "ConstructionPartSection": "insertion colour",
    "ConstructionSection": "ground_m", "FixtureSection": "colour", "PartSection": "count centre_of_mass_m colour insert take_out",
    "ExploreSection": "prices deadline_s designs seconds replications finalists most_replications plans confidence efforts design_limit_s",
    "VarySection": "low high", "GridSection": "counts pitch_m order", "StackSection": "count pitch_m",
    "GripSection": "positions end_margin_m directions steepest_deg tilts_deg around_deg",
    "PartGripSection": "positions end_margin_m directions steepest_deg tilts_deg around_deg",
    "PadSection": "offsets_m", "JoinedSection": "gap_m", "MoveSection": "to_deg to_rad_or_m",
    "RobotSection": "joints home_deg home_rad_or_m xacro", "TeamSection": "count joints", "ToolSection": "joints",
    "ParkedSection": "at_m facing_deg", "PoseSection": "xyz_m rpy_deg quat_wxyz", "PlacesSection": "xyz_m rpy_deg quat_wxyz",
    "RackSection": "xyz_m rpy_deg quat_wxyz", "RingSection": "centre_m start_deg", "RowsSection": "first_m columns pitch_m yaw_deg high",
    "SpiralSection": "growth_m turn_rad high", "TowerSection": "levels", "WallSection": "columns courses joint_m",
    "WellSection": "sides courses section_m joint_m", "PavilionSection": "arches chord_m thickness_m joint_m crown_deg",
    "ProcessSection": "turn_deg turns", "StepSection": "turn_deg", "ProductsSection": "spare start_up seed in_progress rush_after",
    "MachineSection": "capacity batches", "OrderSection": "priority", "VariantSection": "share",
    "OrderChange": "drop more", "RecoverySection": "shortcuts", "StepWindowSection": "steps least", "WindowsSection": "hold",
    "ClearanceSection": "contact_tolerance_m",
    # The mean of a whole distribution is compared.
    "Exponential": "mean_s", "Fixed": "value_s", "Gamma": "shape scale_s mean_s", "Lognormal": "median_s p95_s mean_s",
    "Pert": "low_s mode_s high_s", "Shifted": "offset_s", "Triangular": "low_s mode_s high_s",
    "TruncatedNormal": "mean_s sd_s low_s high_s", "Uniform": "low_s high_s", "Weibull": "shape scale_s",
}  # fmt: skip
"""Keys of which any value that the schema allows is usual: numbers of things, places, angles, colours, costs."""


def sections(base: type[Section] = Section) -> dict[str, type[Section]]:
    """Return the classes of all sections by name."""
    found = {base.__name__: base}
    for own in base.__subclasses__():
        found |= sections(own)
    return found


def numeric(part: object, definitions: dict[str, dict[str, object]]) -> bool:
    """Tell whether a schema allows numbers, of its own or in lists and mappings without sections."""
    if isinstance(part, list):
        return any(numeric(own, definitions) for own in part)
    if not isinstance(part, dict):
        return False
    if str(part.get("$ref", "")):
        own = definitions[part["$ref"].split("/")[-1]]
        return "properties" not in own and numeric(own, definitions)
    kinds = ("anyOf", "oneOf", "allOf", "items", "prefixItems", "additionalProperties")
    return part.get("type") in ("number", "integer") or any(
        numeric(part.get(key), definitions) for key in kinds
    )


def test_every_numeric_key_of_the_schema_has_usual_values_or_none() -> None:
    schema = json.loads((ROOT / "twin/scenario/scenario.schema.json").read_text())
    known, missing, idle = sections(), [], {k: set(v.split()) for k, v in ANY.items()}
    for name, own in schema["$defs"].items():
        for key, part in own.get("properties", {}).items():
            if not numeric(part, schema["$defs"]):
                continue
            fields = known[name].model_fields
            field = next((f for f, i in fields.items() if i.alias == key), key)
            if usual_range(known[name], field) is not None:
                continue
            if field not in ANY.get(name, "").split():
                missing.append(f"{name}.{field}")
            else:
                idle[name].discard(field)
    assert missing == []
    assert {k: v for k, v in idle.items() if v} == {}


def test_every_range_is_of_some_key_and_its_defaults_are_usual() -> None:
    used = set[int]()
    for section in sections().values():
        for key, field in section.model_fields.items():
            usual = usual_range(section, key)
            if usual is None:
                continue
            used.add(id(usual))
            value = field.default
            numbers = value if isinstance(value, tuple) else (value,)
            for number in numbers:
                if isinstance(number, int | float):
                    assert usual.words(number) is None, (section, key, number)
    assert {key for key, own in USUAL.items() if id(own) not in used} == set()


@pytest.mark.parametrize(
    "file", sorted((ROOT / "scenarios").glob("*/*.yaml")), ids=lambda f: f.stem
)
def test_shipped_scenarios_have_usual_numbers(file: Path) -> None:
    scenario, _ = read_scenario(file)
    assert list(check_usual(CheckContext(scenario, file.parent))) == []
