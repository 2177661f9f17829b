"""Effects of single changes of a cell: each change is planned and simulated, and ranked by gain per effort."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import RequestError
from twin.checks.finding import CheckContext
from twin.explorations.crew import Evaluators
from twin.explorations.dimensions import Dimension, base_values, entry_name
from twin.explorations.exploration import Exploration
from twin.explorations.finals import Finals
from twin.explorations.journal import SINGLE, TriedDesign
from twin.explorations.keys import resolved_value
from twin.explorations.section import EFFORTS
from twin.host.progress import Report
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.studies.replications.statistics import Interval

CHANGING, PROVING = "single changes", "gains of single changes"
"""Names of the stages for progress displays."""

_STEP_M, _TURN_DEG, _JOINT_DEG = 0.05, 15.0, 15.0
"""How far things are moved and turned, and joints of HOME [m, deg, deg]."""

_QUICKER = 0.8
"""What is left of the time of a skill with a quicker tool."""

_PROVED = 2
"""Changes that are replicated with new draws, for each that is shown."""


@dataclass(frozen=True)
class CellChange:
    """A change of one key.

    Attributes:
        kind: one of EFFORTS.
        key: the changed key.
        value: its new value.
        words: text on the change, where key and value are unclear.
    """

    kind: str
    key: str
    value: Any
    words: str = ""


@dataclass(frozen=True)
class SingleChange:
    """A single change that was planned and replicated.

    Attributes:
        kind: kind of change.
        words: text on the change.
        gain: by how much the goal is better; intervals hold for all that are shown together.
        effort: of the change, in units of the section.
    """

    kind: str
    words: str
    gain: Interval
    effort: float

    @property
    def sure(self) -> bool:
        """True if its gain is significant."""
        return self.gain.low > 0.0

    @property
    def rate(self) -> float:
        """Gain per unit of effort."""
        return self.gain.estimate / self.effort

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**vars(self), "gain": self.gain.content(), "gain_per_effort": self.rate}


def candidates(scenario: Scenario, folder: Path) -> list[CellChange]:
    """Return single changes of a scenario, a kind after the other in turns.

    Bases and what brings parts are moved by 50 mm along x and y, bases turned by 15 degrees; the first
    joints of HOME by 15 degrees, or 50 mm; neighbours in the list of steps trade places; grips have twice the
    positions, or half the ways to and from parts; skills take a fifth less time.
    """
    content = resolve_scenario(scenario)
    groups = (
        _bases(content),
        _feeders(content),
        _homes(scenario, folder),
        _orders(content),
        _grips(content),
        _tools(scenario),
    )
    turns = zip_longest(*map(list, groups))
    return [item for item in chain.from_iterable(turns) if item is not None]


def _moved(kind: str, content: Mapping[str, Any], at: str) -> Iterator[CellChange]:
    for axis in (0, 1):
        key = f"{at}.xyz_m.{axis}"
        for distance in (-_STEP_M, _STEP_M):
            yield CellChange(
                kind, key, round(resolved_value(content, key) + distance, 9)
            )


def _bases(content: Mapping[str, Any]) -> Iterator[CellChange]:
    for robot in content["cell"]["robots"]:
        at = f"cell.robots.{robot['name']}.base"
        if robot["parked"] is not None:
            continue
        yield from _moved("base", content, at)
        if robot["base"]["quat_wxyz"] is None:
            roll, pitch, yaw = robot["base"]["rpy_deg"] or (0.0, 0.0, 0.0)
            for distance in (-_TURN_DEG, _TURN_DEG):
                words = f"{robot['name']}.base turned about z by {distance:+g} deg"
                turned = [roll, pitch, yaw + distance]
                yield CellChange("base", f"{at}.rpy_deg", turned, words)


def _feeders(content: Mapping[str, Any]) -> Iterator[CellChange]:
    assembly = content["assembly"]
    for name, source in (assembly.get("sources") or {}).items():
        if source.get("pose") is not None:
            yield from _moved("feeder", content, f"assembly.sources.{name}.pose")
    for part in assembly.get("parts", ()):
        if part.get("start") is not None:
            yield from _moved("feeder", content, f"assembly.parts.{part['name']}.start")


def _homes(scenario: Scenario, folder: Path) -> Iterator[CellChange]:
    placed = {
        robot.name: robot for robot in CheckContext(scenario, folder).built.robots
    }
    for robot in scenario.cell.listed:
        own = placed[robot.name]
        if robot.parked is not None or own.model.is_mobile:
            continue
        for joint in range(min(3, own.model.dof)):
            slides = bool(own.model.chain.prismatic[joint])
            step = _STEP_M if slides else float(np.deg2rad(_JOINT_DEG))
            for distance in (-step, step):
                home = np.array(own.home, dtype=float)
                home[joint] += distance
                if not own.model.lower[joint] <= home[joint] <= own.model.upper[joint]:
                    continue
                key, values = "home_rad_or_m", np.round(home, 9)
                if robot.home_deg is not None:
                    key, values = "home_deg", np.round(np.rad2deg(home), 6)
                at = f"cell.robots.{robot.name}.{key}"
                by = (
                    f"{1000.0 * distance:+.0f} mm"
                    if slides
                    else f"{np.rad2deg(distance):+.0f} deg"
                )
                words = f"HOME of {robot.name}: joint {joint + 1} by {by}"
                yield CellChange("home", at, values.tolist(), words)


def _orders(content: Mapping[str, Any]) -> Iterator[CellChange]:
    for key in ("steps", "moves"):
        steps = content["assembly"].get(key) or []
        for k in range(len(steps) - 1):
            swapped = [*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]]
            pair = " and ".join(entry_name(steps[n]) for n in (k, k + 1))
            words = f"{key} {k + 1} and {k + 2} trade places ({pair})"
            yield CellChange("order", f"assembly.{key}", swapped, words)


def _grips(content: Mapping[str, Any]) -> Iterator[CellChange]:
    assembly = content["assembly"]
    if assembly.get("grips"):
        positions = assembly["grips"]["positions"]
        yield CellChange("grip", "assembly.grips.positions", 2 * positions)
        for key in ("approach_m", "leave_m"):
            yield CellChange("grip", f"assembly.{key}", 0.5 * assembly[key])


def _tools(scenario: Scenario) -> Iterator[CellChange]:
    for skill, model in scenario.execution.skills.items():
        if "scale" in type(model).model_fields:
            scale = getattr(model, "scale", 1.0) * _QUICKER
            yield CellChange("tool", f"skills.{skill}.scale", scale)


def change_dimensions(
    scenario: Scenario, changes: Sequence[CellChange]
) -> tuple[Dimension, ...]:
    """Return a dimension for each key of some changes."""
    content, found = resolve_scenario(scenario), dict[str, list[Any]]()
    for item in changes:
        found.setdefault(item.key, []).append(item.value)
    return tuple(
        Dimension(key, resolved_value(content, key), choices=tuple(values))
        for key, values in found.items()
    )


def try_changes(
    exploration: Exploration, crew: Evaluators, changes: Sequence[CellChange]
) -> list[tuple[CellChange, TriedDesign]]:
    """Evaluate changes, each alone, unless evaluated before.

    Raises:
        RequestError: the scenario as it is does not work.
    """
    exploration.search(crew, 1, None)
    base = exploration.journal.searched[0]
    if not base.done:
        found = base.evaluation
        raise RequestError(
            f"the scenario as it is does not work, so no change can be judged: refused at"
            f" {found.rung}: {found.reason}"
        )
    start = base_values(exploration.dimensions)
    values = [{**start, item.key: item.value} for item in changes]
    pairs = zip(values, changes, strict=True)
    wanted = [(v, item.key) for v, item in pairs if exploration.known(v) is None]
    exploration.evaluate(crew, SINGLE, wanted, CHANGING)
    rows = [exploration.known(v) for v in values]
    return [(c, row) for c, row in zip(changes, rows, strict=True) if row is not None]


def judge_changes(
    exploration: Exploration,
    finals: Finals,
    found: Sequence[tuple[CellChange, TriedDesign]],
    most: int,
    progress: Report,
) -> tuple[SingleChange, ...]:
    """Return the changes with the greatest gain per effort, each confirmed with new draws.

    Those that seem to gain most are replicated with new draws, side by side with the scenario as it is.
    Their intervals hold for all of them together (Bonferroni).

    Args:
        exploration: in which they were tried.
        finals: replicates designs.
        found: changes with their evaluations.
        most: how many.
        progress: receives the progress.
    """
    section, base = exploration.section, exploration.journal.searched[0]
    efforts = {**EFFORTS, **{str(k): v for k, v in section.efforts.items()}}
    gains = [
        ((base.evaluation.goals[0] - row.evaluation.goals[0]) / efforts[item.kind], k)
        for k, (item, row) in enumerate(found)
        if row.done
    ]
    chosen = [k for gain, k in sorted(gains, key=lambda g: (-g[0], g[1])) if gain > 0.0]
    chosen = chosen[: _PROVED * most]
    count = min(section.most_replications, 4 * section.replications)
    risk = (1.0 - section.confidence) / max(len(chosen), 1)
    words = {one.key: one for one in exploration.dimensions}
    out = []
    for done, k in enumerate(chosen):
        progress(PROVING, done, len(chosen))
        item, row = found[k]
        gain = finals.difference(base, row, count, 1.0 - risk)
        if gain is not None:
            label = item.words or words[item.key].words(item.value)
            out.append(SingleChange(item.kind, label, gain, efforts[item.kind]))
    progress(PROVING, 1, 1)
    return tuple(sorted(out, key=lambda c: (not c.sure, -c.rate))[:most])
