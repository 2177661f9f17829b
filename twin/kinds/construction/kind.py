"""Assembly kind ``construction``: converts its scenario section to planning data, and plans the motions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.errors import ScenarioError
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Array, Transform, read_only_copy
from twin.document.validation import Problems, check_known_name
from twin.document.yaml_text import KeyPath
from twin.host.progress import StageWatch
from twin.kinds.construction.section import ConstructionSection, ModelSection
from twin.kinds.statics import check_distinct_ends
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.kind import AssemblyKind
from twin.scenario.sections.shapes import to_planning_class

if TYPE_CHECKING:
    from planning.construction.problem.models import ModelPart
    from planning.construction.problem.problem import ConstructionProblem
    from planning.motion.sequential import MotionSettings
    from scheduling.planned_motions import PlannedMotions

CHECKS, PARTS = "what can be built", "parts"
"""Names of the stages for progress displays."""


SHORTEST = 1e-4
"""Shortest edge of a part [m]."""


@dataclass(frozen=True)
class ConstructionKind(AssemblyKind):
    """A construction of a scenario.

    Attributes:
        section: the scenario section.
    """

    section_class = ConstructionSection
    default_speed_model = "joint"
    allows_deviation = False

    section: ConstructionSection

    @property
    def space_time(self) -> bool:
        """True: constructions are planned in space and time."""
        return True

    def steps(self) -> int:
        """Return the number of parts."""
        return len(self.parts)

    def supply(self) -> str:
        """Return a description of the supply."""
        mass = sum(part.mass for part in self.parts)
        return f"{len(self.parts)} parts, {mass:.0f} kg"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key; those of a model have the model's."""
        if self.section.model is not None:
            for part in self.parts:
                yield ("assembly", "model"), part.name
        for i, own in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), own.name

    def reserved(self, name: str) -> str | None:
        """Return whether a name is that of the floor."""
        from planning.construction.problem.site import GROUND

        return "the floor" if name == GROUND else None

    def problems(self, cell: CellSection) -> Problems:
        """Yield invalid joints: of unknown parts, or of a part with itself."""
        from planning.construction.problem.site import GROUND

        for i, robot in enumerate(cell.listed):
            if robot.base_error is not None:
                text = "a construction is planned without base_error: leave it out"
                yield ("cell", "robots", i, "base_error"), text
        if self.section.joined == "neighbours":
            return
        parts = {part.name for part in self.parts}
        things = (
            *(p.name for p in self.parts),
            GROUND,
            *(f.name for f in cell.fixtures),
        )
        for k, item in enumerate(self.section.joined):
            at: KeyPath = ("assembly", "joined", k)
            for i, name in enumerate(item.parts):
                own = (*at, "parts", i)
                yield from check_known_name(own, "part or fixture", name, things)
            yield from check_distinct_ends(at, item.parts, parts, "joined to")
            if item.by is not None:
                yield (
                    (*at, "by"),
                    "a construction joins parts as they are placed: leave it out",
                )

    def fixtures(self) -> tuple[Fixture, ...]:
        """Return the floor."""
        from planning.construction.problem.site import ground_fixture

        return (ground_fixture(self.section.ground_m),)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the parts at their start poses."""
        from planning.construction.problem.site import part_objects
        from planning.construction.problem.supply_layout import Rows, Spiral

        starts: dict[str, Transform] = {
            part.name: read_only_copy(part.start.transform())
            for part in self.section.parts
            if part.start is not None
        }
        supply = self.section.supply
        layout: type[Spiral | Rows] = Spiral if supply.layout == "spiral" else Rows
        laid_out = to_planning_class(layout, supply)
        return part_objects(self.parts, laid_out, starts, near=supply.near)

    def statics(self) -> StandingRules | None:
        """Return the statics settings; None without a balance check."""
        section = self.section
        if not section.balance.check:
            return None
        if section.joined == "neighbours":
            room = section.touch_m
            return to_planning_class(StandingRules, section.balance, joined_within=room)
        joints = tuple(
            to_planning_class(Joint, item, first=item.parts[0], second=item.parts[1])
            for item in section.joined
        )
        return to_planning_class(StandingRules, section.balance, joints=joints)

    def steps_served(self, robot: str, motions: PlannedMotions) -> tuple[int, int]:
        """Return the number of parts that a robot could handle by its reach alone, and of all parts."""
        from planning.construction.problem.reach_bounds import reach_bounds

        problem = motions.assembly.problem
        return len(list(reach_bounds(problem).serves(robot))), len(problem.parts)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Plan in space and time; the stages are checks, keyframes, path and search."""
        from planning.construction.motion_plan_export import motion_plan
        from planning.construction.planner import plan_construction
        from planning.construction.problem.settings import PlannerSettings
        from planning.tasks.assignment import TaskPlan
        from scheduling.planned_motions import PlannedMotions

        with watch.stage("checks", CHECKS):
            problem = self.problem(cell, settings)
        watch.report(PARTS, 0, len(problem.parts))
        with watch.stage("search"):
            effort = PlannerSettings().finding(settings.paths)
            plan = plan_construction(problem, effort, watch.reporter(PARTS))
            motions = motion_plan(problem, plan.building)
        watch.seconds |= plan.seconds
        watch.seconds["search"] -= sum(plan.seconds.values())
        return PlannedMotions(cell, plan, TaskPlan(()), motions, settings)

    @cached_property
    def parts(self) -> tuple[ModelPart, ...]:
        """The parts and where they belong."""
        from planning.construction.problem.models import ModelPart

        if self.section.model is not None:
            return model_parts(self.section.model)
        return tuple(
            to_planning_class(ModelPart, part, size=read_only_copy(part.size_m))
            for part in self.section.parts
        )

    def problem(
        self,
        cell: Workcell,
        settings: MotionSettings,
        parts: Sequence[ModelPart] | None = None,
    ) -> ConstructionProblem:
        """Return the construction problem, checked by lower bounds.

        Args:
            cell: built of the same scenario.
            settings: nominal durations of the skills, and the seed of everything that is drawn.
            parts: placed parts, if not all, or with other goals than in the file; such a problem
                is not checked.

        Raises:
            ConstructionError: it cannot be built as it is, or not by these robots.
            ScenarioError: a skill has no duration but that of its reference path.
        """
        from planning.construction.problem.feasibility import require_buildable
        from planning.construction.problem.problem import SkillSeconds
        from planning.construction.problem.site import build_problem

        seconds = settings.skill_seconds
        for skill in ("pick", "place-down", "handover"):
            if skill not in seconds:
                raise ScenarioError(
                    f"execution.skills.{skill}: a construction is planned with the mean duration"
                    " of its skills, touching a part has no path of its own: give a distribution"
                    " in place of kind: reference"
                )
        insertions: dict[str, Array] = {
            part.name: np.array(part.insertion) / np.linalg.norm(part.insertion)
            for part in self.section.parts
            if part.insertion is not None
        }
        problem = build_problem(
            cell,
            self.parts if parts is None else parts,
            offsets=self.section.grips.offsets_m,
            insertions=insertions,
            approach=self.section.approach_m,
            touch=self.section.touch_m,
        )
        problem = replace(
            problem,
            frame=self.section.grips.frame,
            seconds=SkillSeconds(
                seconds["pick"],
                seconds["place-down"],
                seconds["handover"],
                settings.skill_exceptions,
            ),
            carried=self.section.carried,
            statics=self.statics(),
            seed=settings.seed,
        )
        if parts is None:
            require_buildable(problem)
        return problem


def model_parts(section: ModelSection) -> tuple[ModelPart, ...]:
    """Return the parts of a model: the function of its name knows them.

    Raises:
        ScenarioError: a part has an edge of no length.
    """
    from planning.construction.problem import models

    sizes = {key.removesuffix("_m"): value for key, value in section if key != "name"}
    parts: tuple[ModelPart, ...] = getattr(models, section.name)(**sizes)
    for part in parts:
        if min(part.size) < SHORTEST:
            size = " x ".join(f"{edge:.4g}" for edge in part.size)
            raise ScenarioError(
                f"model {section.name!r}: {part.name} would measure {size} m: the joint leaves"
                " nothing of it"
            )
    return parts
