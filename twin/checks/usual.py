"""Checks of scenario values against usual ranges, to find likely mistakes such as wrong units.

A table gives the usual range of each scenario key, with unit and reason. A value is reported if it is orders of
magnitude outside of its range. Only values that the scenario file contains are compared, no defaults.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import BaseModel

from planning.errors import FittingError
from twin.checks.finding import CheckContext, Finding, Findings
from twin.checks.usual_range import UsualRange, usual_duration
from twin.document.section import iterate_nested
from twin.document.yaml_text import KeyPath
from twin.durations.model import DurationModel
from twin.durations.normal import TruncatedNormal
from twin.planning.fitted_robots import fitted_model
from twin.scenario.sections.cell import LimitsSection
from twin.uncertainty.disturbances import MachineBreakdowns

_RANGES: Mapping[str, UsualRange] = {
    # Robots, tools and grips.
    "velocity": UsualRange(0.01, 30, "rad/s or m/s", "joints of robots reach 1 to 15", False),
    "acceleration": UsualRange(0.05, 500, "rad/s^2 or m/s^2", "joints of robots reach 1 to 100", False),
    "jerk": UsualRange(0.5, 1e5, "rad/s^3 or m/s^3", "joints of robots reach 10 to 10,000", False),
    "effort": UsualRange(0.05, 1e5, "N m or N", "joints of robots exert 1 to 10,000", False),
    "payload_kg": UsualRange(0.05, 3000, "kg", "robots carry 0.5 to 2,000 kg", False),
    "tool_speed_m_s loaded_tool_speed_m_s": UsualRange(0.01, 20, "m/s", "tools move at 0.05 to 10 m/s", False),
    "speed_rad_s": UsualRange(0.02, 15, "rad/s", "joints of robots reach 1 to 10 rad/s", False),
    "repeatability_m": UsualRange(1e-6, 0.01, "m", "robots repeat within 0.01 to 1 mm"),
    "PoseErrorSection.m": UsualRange(1e-6, 0.03, "m", "bases are measured within millimetres"),
    "PoseErrorSection.rad": UsualRange(1e-6, 0.05, "rad", "bases are measured within a degree"),
    "robot_robot_m robot_object_m": UsualRange(1e-5, 0.3, "m", "robots keep off by millimetres to decimetres"),
    "opening_m": UsualRange(0.001, 0.6, "m", "fingers open by millimetres to decimetres"),
    "depth_m finger_width_m finger_depth_m cup_m": UsualRange(5e-4, 0.3, "m", "pads are 1 to 100 mm in size", False),
    "ToolSection.force_n": UsualRange(0.2, 20_000, "N", "grippers close with 1 to 5,000 N", False),
    "ToolSection.mass_kg": UsualRange(0.005, 500, "kg", "tools weigh 10 g to 200 kg"),
    "close_s open_s change_s": UsualRange(0.01, 60, "s", "tools act within seconds"),
    # Bodies and contacts.
    "size_m": UsualRange(5e-4, 12, "m", "robots handle parts of a millimetre to some metres", False),
    "FixtureSection.size_m box PavilionSection.depth_m": UsualRange(5e-4, 200, "m", "bodies are millimetres to metres in size", False),
    "radius_m length_m": UsualRange(2e-4, 100, "m", "bodies are millimetres to metres in size"),
    "ShapeSection.scale PlacedShapeSection.scale": UsualRange(1e-4, 100, "", "meshes are in units of 0.001 to 1 m", False),
    "within_m": UsualRange(1e-4, 0.2, "m", "bodies are true to millimetres", False),
    "mass_kg": UsualRange(1e-6, 5000, "kg", "robots handle grams to hundreds of kilograms"),
    "BrickSection.mass_kg": UsualRange(5e-5, 0.5, "kg", "bricks weigh grams", False),
    "density_kg_m3": UsualRange(5, 23_000, "kg/m^3", "foam has 10 to 100, osmium 22,600", False),
    "friction": UsualRange(0.02, 2, "", "steel on steel has 0.15, rubber about 1", False),
    "tilt_deg": UsualRange(1e-3, 20, "deg", "floors are level within a few degrees"),
    "touch_m joined_overlap_m press_m": UsualRange(1e-7, 0.05, "m", "what touches does so within millimetres"),
    "torque_nm force_n": UsualRange(1e-3, 1e7, "N or N m", "joints bear 0.01 N m to 1 MN", False),
    "press_force_n": UsualRange(0.5, 300, "N", "bricks are pressed on with 5 to 60 N", False),
    "press_margin": UsualRange(0.3, 20, "", "a safety factor is 1 to 5", False),
    "pick place_down place_up handover": UsualRange(1, 60, "deg", "bricks are twisted by 10 to 30 deg"),
    # Steps and lines.
    "approach_m leave_m": UsualRange(0.002, 0.5, "m", "tools approach and leave within some centimetres"),
    "distance_m": UsualRange(1e-4, 3, "m", "cameras and nozzles work within a metre"),
    "within_s at_least_s start_after_s": UsualRange(0.01, 604_800, "s", "windows of time are seconds to days"),
    "every_s": UsualRange(0.05, 86_400, "s", "lines bring a part in 0.5 s to some hours", False),
    "buffer": UsualRange(1, 20, "parts", "where no part may wait, a conveyor stops for each one", False),
    "advance_s refill_s leave_s": UsualRange(1e-3, 86_400, "s", "feeders and products take seconds to minutes"),
    "first_s due due_s": UsualRange(1, 2_592_000, "s", "products are due within hours or days", False),
    "ChangeoverSection.duration cycle_s": UsualRange(0.5, 172_800, "s", "changeovers and cycles take seconds to hours"),
    "ProductsSection.count OrderSection.count RushSection.count": UsualRange(1, 20_000, "products", "a run makes some to thousands"),
    # Execution.
    "latency_s report_latency_s release_latency_s": UsualRange(1e-6, 2, "s", "messages to and from robots take milliseconds"),
    "queue_depth": UsualRange(1, 1000, "nodes", "controllers are given some motions ahead", False),
    "rate_per_h": UsualRange(1e-6, 120, "1/h", "robots stall some times an hour"),
    "count_per_robot": UsualRange(1, 1000, "stalls", "robots stall some times in a run"),
    "duration_s": UsualRange(0.01, 172_800, "s", "standstills last seconds to hours"),
    "mtbf_s": UsualRange(60, 1e9, "s", "machines fail after hours to years", False),
    "mttr_s": UsualRange(1, 2_592_000, "s", "repairs take minutes to days"),
    "repair_people": UsualRange(1, 50, "people", "a cell has some people for repairs"),
    "PlannedStop.every_s": UsualRange(60, 2_592_000, "s", "breaks and maintenance are hours to weeks apart"),
    "at_s": UsualRange(0.01, 864_000, "s", "operations last hours or days"),
    "probability SkillFailure.parts": UsualRange(1e-9, 0.5, "", "work that fails more often than not is none"),
    "loses slips wrong beside": UsualRange(1e-9, 0.9, "", "failures are of several kinds"),
    "helps": UsualRange(0.05, 1, "", "a person mostly can help", False),
    "retries again times": UsualRange(1, 50, "times", "nobody tries the same again and again"),
    "planning_s remove_s": UsualRange(1e-3, 1800, "s", "replanning and a hand's turn take seconds to minutes"),
    "answer_s": UsualRange(0.5, 86_400, "s", "a person answers within minutes"),
    "value UniformFactor.low UniformFactor.high median p95": UsualRange(0.05, 5, "", "a factor of what is planned"),
    "DurationModel.scale": UsualRange(0.02, 50, "", "a factor of what was measured"),
    "cv": UsualRange(1e-3, 4, "", "times scatter by less than their mean"),
    # Planning.
    "step_s": UsualRange(0.002, 0.5, "s", "motions are looked at every 10 to 100 ms"),
    "attempts": UsualRange(1, 200, "", "more attempts find nothing new"),
    "shortcut_candidates sidestep_candidates assignment_moves improve_tries search_limit": UsualRange(1, 500_000, "", "more gains nothing"),
    "shortcut_s improve_s": UsualRange(1e-3, 86_400, "s", "planning takes up to hours"),
}  # fmt: skip

_ROUNDED = 1.7e-3
"""Angles in radians are written with two decimals or more."""

_CUT = 1.5
"""Largest ratio of the mean of a truncated normal distribution to the untruncated one."""

USUAL = {key: own for keys, own in _RANGES.items() for key in keys.split()}
"""Usual values by key, and by class of the section and key where keys of several sections have one name."""

_FASTER = 2.0
"""Largest ratio of a velocity limit to that of the robot's description."""

_LIGHTEST, _HEAVIEST = 0.5, 30_000.0
"""Densities of bodies: air has 1.2, osmium 22,600 [kg/m^3]."""


def usual_range(section: type[BaseModel], key: str) -> UsualRange | None:
    """Return the usual values of a key of a section; None where any value is usual."""
    names = [f"{base.__name__}.{key}" for base in section.__mro__]
    return next((USUAL[name] for name in (*names, key) if name in USUAL), None)


def check_usual(subject: CheckContext) -> Findings:
    """Yield the numbers and durations of the file that are far from usual."""
    seen = set[int]()  # the skills of processes are the durations that these give
    for path, section in iterate_nested(subject.scenario):
        if not isinstance(section, BaseModel) or id(section) in seen:
            continue
        seen.add(id(section))
        if isinstance(section, DurationModel):
            mean = section.located(subject.folder).mean
            if words := usual_duration([*map(str, path)]).words(mean):
                yield Finding(path, f"the mean of {_name(path)}, {words}")
            yield from _check_cut(section, mean, path)
        for key in sorted(section.model_fields_set):
            usual, given = usual_range(type(section), key), getattr(section, key)
            if isinstance(given, BaseModel):
                continue
            place = (*path, type(section).model_fields[key].alias or key)
            numbers = {
                at: float(value)
                for at, value in iterate_nested(given, place)
                if isinstance(value, int | float) and not isinstance(value, bool)
            }
            if key.endswith("_deg") and _in_radians([*numbers.values()]):
                yield Finding(
                    place,
                    f"{_name(place)} {', '.join(f'{v:g}' for v in numbers.values())} is in degrees, and has values of"
                    " right angles or their parts in radians; if it is in radians, write it in degrees",
                )
            for at, value in numbers.items():
                if usual is not None and (words := usual.words(value)):
                    yield Finding(at, f"{_name(at)} {words}")


def _check_cut(model: DurationModel, mean: float, at: KeyPath) -> Findings:
    """Yield normal distributions whose truncation shifts the mean."""
    if isinstance(model, TruncatedNormal) and mean > _CUT * model.mean_s * model.scale:
        yield Finding(
            at,
            f"{_name(at)} has mean_s {model.mean_s:g} and sd_s {model.sd_s:g}: cut off at low_s {model.low_s:g}, its mean"
            f" is {mean:.3g} s; give a smaller sd_s, or a distribution that has no values below 0, such as a lognormal",
        )


def _in_radians(angles: list[float]) -> bool:
    """Return whether angles are likely in radians: fractions of pi, and none above a turn."""
    sizes = np.abs([angle for angle in angles if angle])
    if len(sizes) == 0 or sizes.max() > 2.0 * np.pi + _ROUNDED:
        return False
    parts = np.concatenate([np.arange(1, 9) * np.pi / 4, np.arange(1, 13) * np.pi / 6])
    hits = np.abs(sizes[:, None] - parts).min(axis=1) < _ROUNDED
    # Of the joints of a robot at HOME, only some are at such angles.
    return bool(hits.all() or (hits.any() and len(angles) > 3))


def _name(at: KeyPath) -> str:
    """Return a short name of a key: the last names of its path."""
    return ".".join([key for key in at if isinstance(key, str)][-2:])


def check_rates(subject: CheckContext) -> Findings:
    """Yield robots and machines that stand longer than they work."""
    execution = subject.scenario.execution
    for path, own in iterate_nested(execution, ("execution",)):
        if not isinstance(own, MachineBreakdowns):
            continue
        found = own.located(subject.folder)
        mtbf, mttr = found.between.mean, found.repair.mean
        if mttr > mtbf:
            key = "mttr" if own.mttr_s is None else "mttr_s"
            yield Finding(
                (*path, key),
                f"{key} {mttr:g} s is longer than mtbf_s {mtbf:g} s: under repair for more than half of the time;"
                " usual is less than a tenth of mtbf_s",
            )
    stalls = execution.stalls
    stood = stalls.rate_per_h * stalls.model.located(subject.folder).mean / 3600.0
    if stood > 1.0:
        yield Finding(
            ("execution", "stalls", "rate_per_h"),
            f"rate_per_h {stalls.rate_per_h:g} makes robots stand still for {stood:.3g} h in an hour of work; usual is"
            " less than 0.1 h",
        )


def check_physics(subject: CheckContext) -> Findings:
    """Yield physically implausible robots and objects.

    Joints far faster than their description, masses that cannot be those of their volumes, and robots that hang
    upside down below all that they could handle.
    """
    cell, objects = subject.scenario.cell, subject.cell.objects
    for robot in cell.listed:
        if robot.limits.velocity is None:
            continue
        bare = robot.changed(limits=LimitsSection())
        try:
            described = fitted_model(bare, cell, subject.folder).velocity
        except FittingError:  # the description has no speeds
            continue
        model = subject.built.robot(robot.name).model
        ratio = model.velocity / np.maximum(described, 1e-9)
        k = int(np.argmax(ratio))
        if _FASTER < ratio[k] < 1e6:  # a description may lack it
            yield Finding(
                subject.robot_at(robot.name, "limits"),
                f"limits.velocity of {robot.name} is {model.velocity[k]:g} at {model.joint_names[k]}, {ratio[k]:.3g}"
                f" times the {described[k]:g} of {robot.model}; usual is at most {_FASTER:g} times",
            )
    for item in objects:
        density = item.mass / max(item.shape.volume, 1e-15)
        if item.mass > 0.0 and not _LIGHTEST <= density <= _HEAVIEST:
            yield Finding(
                subject.thing_at(item.name, "mass_kg"),
                f"{item.name} weighs {item.mass:g} kg and has {item.shape.volume * 1e6:.3g} cm^3: {density:.3g} kg/m^3,"
                f" and usual is {_LIGHTEST:g} to {_HEAVIEST:g} kg/m^3; correct its mass or its size",
                code="density",
                parts=(item.name,),
            )
    lowest = min((float(item.start[2, 3]) for item in objects), default=-np.inf)
    for placed in subject.cell.robots:
        if placed.base[2, 2] < -0.7 and placed.base[2, 3] < lowest:
            yield Finding(
                subject.robot_at(placed.name, "base"),
                f"{placed.name} hangs upside down from z = {placed.base[2, 3]:g} m, below all objects, the lowest of"
                f" which is at {lowest:g} m; usual is a base above them, or one that stands upright",
            )
