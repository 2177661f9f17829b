"""Explanation of one assembly step: the equilibrium of the structure while a brick is pressed on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import LegoAssembly, PlacedBrick
from planning.lego.insertion.insertion import Insertions, InsertionSite
from planning.lego.insertion.rules import SequencingRules
from planning.lego.stability.contacts import ToolHold
from planning.lego.stability.partial_structures import PartialStructures
from planning.statics.equilibrium import Load, StabilityReport

MOST = 100.0
"""Upper limit of the search for the greatest force that a structure bears [N]."""


@dataclass(frozen=True)
class ExplainedStep:
    """The equilibrium while a brick is pressed on.

    Attributes:
        number: of the step, from 1.
        bricks: that are there, the pressed one last.
        load: of the press that the step prefers.
        holds: of the support that it prefers.
        needed: force that it takes [N].
        bears: largest force that the structure bears, up to ``MOST`` [N].
        bears_unsupported: the same without the support [N].
        report: the joints that are pulled by the force that it takes.
        temporary: names of the bricks that only help, and do not stay.
    """

    number: int
    bricks: tuple[PlacedBrick, ...]
    load: Load
    holds: tuple[ToolHold, ...]
    needed: float
    bears: float
    bears_unsupported: float
    report: StabilityReport
    temporary: frozenset[str]

    @property
    def friction_shares(self) -> dict[str, float]:
        """The largest share of friction that any joint of each brick uses."""
        friction_shares = dict.fromkeys((item.name for item in self.bricks), 0.0)
        for first, second, share in self.report.pulled:
            for name in (first, second):
                if name is not None:
                    friction_shares[name] = max(friction_shares[name], share)
        return friction_shares


def explain_step(
    assembly: LegoAssembly, number: int, rules: SequencingRules
) -> ExplainedStep:
    """Return the equilibrium of a step with the grip and the support that it prefers.

    Raises:
        ScenarioError: there is no such step, or it leaves the grip open.
    """
    total = len(assembly.steps)
    if not 1 <= number <= total:
        raise ScenarioError(f"there is no step {number}: steps are 1 to {total}")
    step = assembly.steps[number - 1]
    if step.press is None:
        raise ScenarioError(f"step {number} does not say its grip")
    there = [*assembly.scaffold, *assembly.structure[:number]]
    structures = PartialStructures(there)
    names, name = frozenset(structures.bricks), there[-1].name

    def site(rules: SequencingRules) -> InsertionSite:
        return Insertions(structures, rules).at(names, name, up=step.up)

    real, strong = site(rules), site(replace(rules, force=MOST, margin=1e9))
    return ExplainedStep(
        number,
        tuple(there),
        real.load(step.press),
        real.holds(step.support),
        real.force,
        max(0.0, strong.bears(step.press, step.support).bears),
        max(0.0, strong.bears(step.press).bears),
        real.weakness(step.press, step.support),
        frozenset(
            item.name
            for item, own in zip(assembly.structure, assembly.steps, strict=True)
            if own.temporary
        ),
    )
