"""Check of the balance of an assembly: what would fall over once it is in its place."""

from __future__ import annotations

from twin.check.finding import Finding, Findings, Subject


def check_balance(subject: Subject) -> Findings:
    """Yield the first part that would fall, in the order in which parts are put in place."""
    from planning.parts.balance import PartBalance, balance_groups

    parts = subject.parts
    if parts is None or parts.steps is None or parts.listed.balance is None:
        return
    gone = parts.listed.supply.leaves.keys()
    for _, own, rule in balance_groups(parts.steps, parts.listed.balance, gone):
        balance = PartBalance(subject.cell, own, rule)
        if balance.fall is not None:
            yield Finding(
                subject.thing_at(balance.fall.body, "goal"),
                balance.refusal(balance.fall),
                error=True,
            )
            return
