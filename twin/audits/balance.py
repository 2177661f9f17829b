"""Audit of static equilibrium: placed parts must be stable at all times.

Friction, joints between parts, or a robot that holds a part can provide the stability.
"""

from __future__ import annotations

from collections.abc import Iterator

from planning.statics.standing import StabilityChecker, body_at, ground_bodies
from twin.audits.case import AuditCase, Violation
from twin.audits.part_holding import states_and_holds
from twin.audits.places import rests_at


def balance_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield parts without static equilibrium, with time intervals.

    Parts elsewhere, such as in the supply, are assumed stable. Bodies come from the plan's cell, poses
    from the execution. Another part of the same kind may be at a part's place.
    """
    rules, cell = case.wanted.statics, case.cell
    if rules is None:
        return
    goals = {p.object: p.pose for p in case.wanted.places if p.object is not None}
    bodies = {name: body_at(cell.object(name), pose) for name, pose in goals.items()}
    objects = {item.name: item for item in cell.objects}
    alike = {
        name: [k for k, item in objects.items() if item.kind == objects[name].kind]
        for name in goals
    }
    standing = StabilityChecker(bodies, ground_bodies(cell, bodies), rules)
    since: tuple[float, str, str] | None = None
    for t, there, kept in states_and_holds(case):
        placed, held = [], []
        for name, pose in goals.items():
            who = next(
                (
                    other
                    for other in (name, *alike[name])
                    if other in there and rests_at(objects[other], there[other], pose)
                ),
                None,
            )
            if who is not None:
                placed.append(name)
                if who in kept:
                    held.append(name)
        body = standing.falling(placed, joints=standing.joints, held=held)
        if since is not None and body != since[1]:
            yield _fallen(since, t)
            since = None
        if body is not None and since is None:
            since = t, body, standing.why(body, placed)
    if since is not None:
        yield _fallen(since, case.end)


def _fallen(since: tuple[float, str, str], until: float) -> Violation:
    begin, body, why = since
    return Violation(begin, until, body, "gravity", 0.0, f"falls: {why}", "balance")
