"""What is in its place must stand at all times: by friction, by joints, or in somebody's hand."""

from __future__ import annotations

from collections.abc import Iterator

from planning.statics.standing import Standing, body_at, ground_of
from twin.audit.case import AuditCase
from twin.audit.places import PLACED, distance_of
from twin.audit.supports import held_in_place
from twin.audit.violation import Violation


def balance_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield what falls, from when to when, by the static equilibrium of what is in place.

    What is elsewhere, such as in the supply, is taken to lie well. Parts are the bodies that the
    plan's cell has; where they are is what was executed.
    """
    rules, cell = case.wanted.statics, case.cell
    if rules is None:
        return
    goals = {p.object: p.pose for p in case.wanted.places if p.object is not None}
    bodies = {name: body_at(cell.object(name), pose) for name, pose in goals.items()}
    standing = Standing(bodies, ground_of(cell, bodies), rules)
    since: tuple[float, str, str] | None = None
    kept = held_in_place(case)
    ends = [until for _, until in kept.values() if 0.0 < until <= case.end]
    for t, there in case.states(*ends):
        placed = [
            name
            for name, pose in goals.items()
            if (stay := there.get(name)) is not None
            and stay.holder is None
            and distance_of(cell.object(name), stay.pose, pose) <= PLACED
        ]
        held = [n for n in placed if n in kept and kept[n][0] <= t < kept[n][1]]
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
