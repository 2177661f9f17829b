"""What a structure bears at one step of a sequence: how much, and which joints give way first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import LegoAssembly, PlacedBrick
from planning.lego.insertion.insertion import InsertionRules
from planning.lego.sequencing.rules import SequencingRules
from planning.lego.stability.partial_structures import PartialStructures
from planning.lego.stability.stability import Hold, Load
from planning.statics.equilibrium import StabilityReport

MOST = 100.0
"""The force that a structure bears is sought up to this one [N]."""


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
        alone: the same without the support [N].
        report: the joints that are pulled by the force that it takes.
    """

    number: int
    bricks: tuple[PlacedBrick, ...]
    load: Load
    holds: tuple[Hold, ...]
    needed: float
    bears: float
    alone: float
    report: StabilityReport


def explain_step(
    assembly: LegoAssembly, number: int, rules: SequencingRules
) -> ExplainedStep:
    """Return the equilibrium of a step with the grip and the support that it prefers.

    Args:
        assembly: with its steps.
        number: of the step, from 1.
        rules: force and margin.

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
    names = frozenset(structures.bricks)

    def site(force: float, margin: float) -> InsertionRules:
        return InsertionRules(structures, force, margin, rules.robot)

    name = assembly.structure[number - 1].name
    real = site(rules.force, rules.margin).at(names, name, up=step.up)
    strong = site(MOST, 1e9).at(names, name, up=step.up)
    return ExplainedStep(
        number,
        tuple(there),
        real.load(step.press),
        real.holds(step.support),
        real.force,
        max(0.0, strong.bears(step.press, step.support).bears),
        max(0.0, strong.bears(step.press).bears),
        real.weakness(step.press, step.support),
    )


def strain_of(
    report: StabilityReport, bricks: Sequence[PlacedBrick]
) -> dict[str, float]:
    """Return the largest share of friction that any joint of each brick uses."""
    strain = dict.fromkeys((item.name for item in bricks), 0.0)
    for first, second, share in report.pulled:
        for name in (first, second):
            if name is not None:
                strain[name] = max(strain[name], share)
    return strain
