"""Check of the balance of an assembly: what would fall over once it is in its place."""

from __future__ import annotations

from planning.errors import ConstructionError, InfeasibleStepError
from twin.check.finding import Finding, Findings, Subject
from twin.scenario.sections.parts import PartsSection


def check_balance(subject: Subject) -> Findings:
    """Yield the first part that would fall, in the order in which parts are put in place."""
    section = subject.scenario.assembly
    if not isinstance(section, PartsSection):
        return
    from planning.parts.balance import PartBalance, balance_groups
    from planning.parts.order import in_found_order
    from planning.parts.part_steps import part_steps
    from twin.planning.parts import build_assembly

    cell, assembly = subject.cell, build_assembly(section)
    rules = assembly.balance
    if rules is None:
        return
    try:
        if section.order == "find":
            assembly = in_found_order(cell, assembly)
        steps = part_steps(cell, assembly)
    except (ConstructionError, InfeasibleStepError):
        return  # said elsewhere
    for _, own, rule in balance_groups(steps, rules, assembly.supply.leaves.keys()):
        balance = PartBalance(cell, own, rule)
        if balance.fall is not None:
            yield Finding(
                subject.thing_at(balance.fall.body, "goal"),
                balance.refusal(balance.fall),
                error=True,
            )
            return
