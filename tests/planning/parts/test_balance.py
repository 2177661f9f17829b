"""Balance of assemblies: what falls is refused with what helps, what props it up comes before."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.parts.balance import PartBalance
from planning.parts.order import in_found_order
from planning.parts.part_steps import part_steps
from planning.statics.standing import Joint, StandingRules
from planning.transforms import translation
from tests.planning.parts.boxes import built, part, table

RULES = StandingRules()


AWAY = translation(2.0, 2.0, 5.0)
PARTS = (
    part("post", (0.1, 0.1, 0.1), AWAY),
    part("beam", (0.5, 0.1, 0.02), AWAY),
    part("prop", (0.02, 0.1, 0.1), AWAY),
    part("load", (0.05, 0.05, 0.05), AWAY, 3.0),
)
GOALS = {
    "post": translation(0.0, 0.0, 0.05),
    "beam": translation(0.15, 0.0, 0.11),
    "prop": translation(0.35, 0.0, 0.05),
    "load": translation(0.3, 0.0, 0.145),
}
CELL = Workcell((), (table(),), PARTS)


def assembly(*names: str, rules: StandingRules = RULES) -> PartAssembly:
    return built(GOALS, *names, balance=rules)


def balance(found: PartAssembly) -> PartBalance:
    assert found.balance is not None
    return PartBalance(CELL, part_steps(CELL, found), found.balance)


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
    for torque in (5.0, 12.0, math.inf):
        neck = Joint("post", "beam", 1.0, torque)
        rules = replace(RULES, joints=(Joint("table", "post"), neck))
        fall = balance(assembly("post", "beam", "load", rules=rules)).fall
        # 3 kg at 0.25 m and 1 kg at 0.1 m from the edge of the post: 8.3 N m.
        assert (fall is None) == (torque > 8.3)
        assert fall is None or (fall.step, fall.body) == (2, "beam")


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
    found = in_found_order(CELL, listed)
    assert balance(found).fall is None
    order = list(found.placed)
    assert order.index("prop") < order.index("beam") < order.index("load")
    blind = in_found_order(CELL, replace(listed, balance=None))
    assert set(blind.placed) == set(order)


def test_what_touches_nothing_may_stand_where_it_is_joined() -> None:
    goals = {**GOALS, "beam": translation(0.15, 0.0, 0.13)}
    free = built(goals, "post", "beam", balance=RULES)
    with pytest.raises(InfeasibleStepError, match="in the air"):
        part_steps(CELL, free)
    joints = (Joint("table", "post"), Joint("post", "beam", gap=0.02))
    joined = replace(free, balance=replace(RULES, joints=joints))
    assert balance(joined).stand().waits == {(0, 1)}
