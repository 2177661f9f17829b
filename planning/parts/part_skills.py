"""Skills of one robot on parts: pick, place, hold and processes that nothing is in the way of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import entity
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_in_flange
from planning.motion.sequential import MARGIN
from planning.parts.assembly import Grip, PartAssembly
from planning.parts.part_steps import Held, PartStep, WorkStep
from planning.parts.targets import (
    hold_targets,
    pick_targets,
    place_targets,
    process_targets,
)
from planning.parts.tool_fit import tool_misfit
from planning.skills.contacts import (
    NOTHING,
    SkillContacts,
    ToolContact,
    gripped,
    touching,
)
from planning.skills.joint_paths import Obstruction, SkillPath
from planning.skills.subgoals import SkillTargets
from planning.skills.surroundings import (
    SkillScene,
    find_obstruction,
    resolve_skill,
)
from planning.transforms import Array, Transform, inverse, readonly

PRESSED = 0.003
"""Deepest that the tool of a process may be in what it works at [m]."""


def held_pose(robot: PlacedRobot, frame: str, grip: Transform) -> Transform:
    """Return the pose of a part in the flange frame of the robot that holds it.

    Args:
        robot: who holds it.
        frame: name of the tool frame.
        grip: pose of that frame in the frame of the part.
    """
    tool = frame_in_flange(robot.model, frame)
    return readonly(tool @ inverse(grip))


@dataclass(frozen=True)
class PartSkills:
    """Skills in one cell, with all other robots at HOME but for those that hold something.

    Attributes:
        cell: robots and fixtures.
        assembly: grips, approaches and ways back.
        holding: configurations of the robots that hold something.
    """

    cell: Workcell
    assembly: PartAssembly
    holding: Mapping[str, Array] = field(default_factory=dict)

    def misfit(
        self, robot: PlacedRobot, part: CellObject, grip: Grip
    ) -> Obstruction | None:
        """Return why a robot's tool cannot hold a part by a grip, None where it can."""
        approach = self.assembly.ways(part.name).approach
        return tool_misfit(robot, self.assembly.grips.frame, part, grip, approach)

    def pick(
        self,
        robot: PlacedRobot,
        step: PartStep,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return the pick of a step by a grip; one that is known, where it is free.

        Grips are poses of the tool in the frame of the part.
        """
        part, frame = step.part, self.assembly.grips.frame
        held = gripped(robot.name, part.name)
        in_hand = Attachment(robot.name, held_pose(robot, frame, grip))
        ways = self.assembly.ways(part.name)
        targets = pick_targets(
            frame, part.start @ grip, ways.approach, ways.leave, ways.extraction
        )
        contacts = SkillContacts(
            NOTHING, held | touching(part.name, step.at_start), held
        )
        changes = Attachment(None, part.start), in_hand
        return self._handle(robot, step, targets, contacts, changes, known)

    def place(
        self,
        robot: PlacedRobot,
        step: PartStep,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return the place-down of a step by a grip; one that is known, where it is free."""
        part, frame = step.part, self.assembly.grips.frame
        held = gripped(robot.name, part.name)
        in_hand = Attachment(robot.name, held_pose(robot, frame, grip))
        ways = self.assembly.ways(part.name)
        targets = place_targets(
            frame, step.goal @ grip, ways.approach, ways.leave, ways.insertion
        )
        contacts = SkillContacts(
            held, held | touching(part.name, step.at_goal), NOTHING
        )
        changes = in_hand, Attachment(None, step.goal)
        return self._handle(robot, step, targets, contacts, changes, known)

    def carried_home(
        self, robot: PlacedRobot, step: PartStep, grip: Transform
    ) -> Obstruction | None:
        """Return what is in the way of a robot that stands at HOME with a part."""
        name = step.part.name
        in_hand = Attachment(
            robot.name, held_pose(robot, self.assembly.grips.frame, grip)
        )
        attachments = {k: at for k, (_, at) in step.around.items()} | {name: in_hand}
        state = WorldState(self._configurations, attachments)
        held = gripped(robot.name, name)
        checker = SceneChecker(self.cell, robot.name, state, held, margin=MARGIN)
        contact = checker.contact(robot.home)
        if contact is None:
            return None
        return Obstruction(str(contact), contact.second.split(":")[0])

    def in_door(self, door: str) -> str | None:
        """Return the first robot that stands in a door when it is at HOME, None for none."""
        leaf = Attachment(None, self.cell.object(door).start)
        state = WorldState(self._configurations, {door: leaf})
        for robot in self.cell.robots:
            alone = replace(self.cell, robots=(robot,), fixtures=())
            checker = SceneChecker(alone, robot.name, state, NOTHING, margin=MARGIN)
            if checker.contact(robot.home) is not None:
                return robot.name
        return None

    def hold(
        self,
        robot: PlacedRobot,
        step: PartStep | WorkStep,
        held: Held,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return how a robot grips a part where it lies; as is known, where that is free."""
        part = held.part.name
        at_part = gripped(robot.name, part)
        targets = hold_targets(
            self.assembly.grips.frame,
            held.pose @ grip,
            self.assembly.ways(part).approach,
        )
        contacts = SkillContacts(NOTHING, at_part, at_part)
        scene = SkillScene(self.cell, step.around, self._configurations, contacts)
        if known is not None and find_obstruction(known, scene) is None:
            return known
        found = resolve_skill(robot, targets, scene)
        return found if isinstance(found, Obstruction) else found.path

    def work(
        self,
        robot: PlacedRobot,
        step: WorkStep,
        turn: float,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return a process with its approach and way back; a known one, where it is free."""
        targets = process_targets(step.step.process, step.place, turn).targets
        touches = touching(entity(robot.name, "tool"), step.touched)
        scene = SkillScene(
            self.cell,
            step.around,
            self._configurations,
            SkillContacts(NOTHING, touches, NOTHING),
            tool=ToolContact(0.0, PRESSED),
        )
        if known is not None and find_obstruction(known, scene) is None:
            return known
        found = resolve_skill(robot, targets, scene)
        if isinstance(found, Obstruction):
            return found
        if found.touched:
            beside = min(found.touched)
            return Obstruction(f"the tool comes too near to {beside}", beside)
        return found.path

    def _handle(
        self,
        robot: PlacedRobot,
        step: PartStep,
        targets: SkillTargets,
        contacts: SkillContacts,
        changes: tuple[Attachment, Attachment],
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return a skill, given where the part is before and after it changes hands."""
        part = step.part
        objects = {**step.around, part.name: (part, changes[0])}
        scene = SkillScene(
            self.cell,
            objects,
            self._configurations,
            contacts,
            (part.name, changes[1]),
        )
        if known is not None and find_obstruction(known, scene) is None:
            return known
        found = resolve_skill(robot, targets, scene)
        return found if isinstance(found, Obstruction) else found.path

    @property
    def _configurations(self) -> dict[str, Array]:
        home = {robot.name: robot.home for robot in self.cell.robots}
        return {**home, **self.holding}
