"""Balance of assemblies: what falls is refused with what helps, what props it up comes before."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly, PlacePart
from planning.parts.balance import PartBalance
from planning.parts.order import in_found_order
from planning.parts.part_steps import part_steps
from planning.statics.standing import Joint, StandingRules
from planning.transforms import Transform, translation

RULES = StandingRules()


def part(name: str, size: tuple[float, float, float], mass: float = 0.0) -> CellObject:
    edges = np.array(size)
    return CellObject(name, "box", box_shape(name, edges), at(2.0, 2.0, 5.0), mass)


def at(x: float, y: float, z: float) -> Transform:
    return translation(x, y, z)


PARTS = (
    part("post", (0.1, 0.1, 0.1)),
    part("beam", (0.5, 0.1, 0.02)),
    part("prop", (0.02, 0.1, 0.1)),
    part("load", (0.05, 0.05, 0.05), 3.0),
)
GOALS = {
    "post": at(0.0, 0.0, 0.05),
    "beam": at(0.15, 0.0, 0.11),
    "prop": at(0.35, 0.0, 0.05),
    "load": at(0.3, 0.0, 0.145),
}


def cell() -> Workcell:
    table = np.array([2.0, 2.0, 0.02])
    top = Fixture("table", box_shape("table", table), at(0, 0, -0.01))
    return Workcell((), (top,), PARTS)


def assembly(*names: str, rules: StandingRules = RULES) -> PartAssembly:
    steps = tuple(PlacePart(part=name, name=name) for name in names)
    return PartAssembly(GOALS, steps, balance=rules)


def balance(built: PartAssembly) -> PartBalance:
    assert built.balance is not None
    return PartBalance(cell(), part_steps(cell(), built), built.balance)


def test_a_cantilever_is_refused_with_the_step_the_part_and_what_helps() -> None:
    found = balance(assembly("post", "beam", "prop", "load"))
    with pytest.raises(InfeasibleStepError) as caught:
        found.stand()
    text = str(caught.value)
    assert text.startswith(
        "step 2 (pick and place beam): beam would not stand after it"
    )
    assert "no forces between it and post keep it in balance" in text
    assert "joined: [[post, beam]]" in text
    assert "place prop before" in text
    assert "let a later step join it" in text


def test_what_is_propped_waits_for_its_prop() -> None:
    waits = balance(assembly("post", "prop", "beam", "load")).stand().waits
    # The beam touches the prop and waits for it anyway; nothing more is needed.
    assert waits == frozenset()


def test_a_joint_does_instead_of_a_prop_as_far_as_it_bears() -> None:
    def built(torque: float) -> PartAssembly:
        base = Joint("table", "post")
        neck = Joint("post", "beam", 1.0, torque)
        return assembly(
            "post", "beam", "load", rules=replace(RULES, joints=(base, neck))
        )

    assert balance(built(math.inf)).fall is None
    # 3 kg at 0.25 m and 1 kg at 0.1 m from the edge of the post: 8.3 N m.
    weak = balance(built(5.0)).fall
    assert weak is not None
    assert weak.body == "beam"
    assert weak.step == 2
    assert balance(built(12.0)).fall is None


def test_what_a_later_step_joins_is_kept_hold_of_until_then() -> None:
    late = replace(
        RULES,
        joints=(Joint("table", "post"), Joint("post", "beam", by="prop")),
    )
    found = balance(assembly("post", "beam", "prop", rules=late))
    assert found.fall is None
    assert found.stand().keeps == {1: 2}


def test_an_order_is_found_in_which_everything_stands() -> None:
    listed = assembly("load", "beam", "prop", "post")
    found = in_found_order(cell(), listed)
    assert balance(found).fall is None
    order = list(found.placed)
    assert order.index("prop") < order.index("beam") < order.index("load")
    blind = in_found_order(cell(), replace(listed, balance=None))
    assert set(blind.placed) == set(order)


def test_what_touches_nothing_may_stand_where_it_is_joined() -> None:
    goals = {**GOALS, "beam": at(0.15, 0.0, 0.13)}
    steps = tuple(PlacePart(part=name, name=name) for name in ("post", "beam"))
    free = PartAssembly(goals, steps, balance=RULES)
    with pytest.raises(InfeasibleStepError, match="in the air"):
        part_steps(cell(), free)
    across = Joint("post", "beam", gap=0.02)
    joints = (Joint("table", "post"), across)
    built = replace(free, balance=replace(RULES, joints=joints))
    assert balance(built).stand().waits == {(0, 1)}
