"""Names of execution policies in commands, tables and files.

A policy combines a plan with a rule for the release of its nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from planning.errors import RequestError
from twin.registry import POLICIES

if TYPE_CHECKING:
    from twin.runs.execution_record import Policy

# Names of plans, described below.
IN_TURNS = "in turns"
SHORTENED = "shortened"
IN_SLOTS = "in slots"
SLOTS_SHORTENED = "in slots, shortened"
AT_ONCE = "at once"
"""Names of plans: motions planned one task after another; the same with an improved task order and shortcuts;
motions in slots; the same with shortcuts; and space-time planning, as for constructions."""

WHOLE_PLANS = {SHORTENED: IN_TURNS, SLOTS_SHORTENED: IN_SLOTS}
"""Base plan of each plan with shortcuts."""

SEQUENTIAL = "sequential"
SYNCHRONOUS = "synchronous"
SYNCHRONOUS_TPG = "synchronous + TPG"
SYNCHRONOUS_SHORTCUTS = "synchronous + TPG + shortcuts"
ASYNCHRONOUS = "asynchronous"
ASYNCHRONOUS_SHORTCUTS = "asynchronous + shortcuts"
OPEN_LOOP = "open-loop"

PLAIN_POLICIES = (SEQUENTIAL, SYNCHRONOUS, SYNCHRONOUS_TPG, ASYNCHRONOUS)
"""Safe policies without shortcuts, the baselines of the gain of shortcuts."""


class NamedPolicy(NamedTuple):
    """A policy by its parts: the plan that is executed, and how its nodes are released."""

    plan: str
    release: Policy


NAMED_POLICIES = {
    SEQUENTIAL: NamedPolicy(IN_TURNS, "sequential"),
    SYNCHRONOUS: NamedPolicy(IN_SLOTS, "synchronous"),
    SYNCHRONOUS_TPG: NamedPolicy(IN_SLOTS, "asynchronous"),
    SYNCHRONOUS_SHORTCUTS: NamedPolicy(SLOTS_SHORTENED, "asynchronous"),
    ASYNCHRONOUS: NamedPolicy(IN_TURNS, "asynchronous"),
    ASYNCHRONOUS_SHORTCUTS: NamedPolicy(SHORTENED, "asynchronous"),
    OPEN_LOOP: NamedPolicy(IN_TURNS, "open-loop"),
}
"""What each name of this program means, in the order of tables and charts."""


def named_policies() -> dict[str, NamedPolicy]:
    """Return what each policy name means, with registered policies last."""
    found = dict(NAMED_POLICIES)
    for release in POLICIES.names():
        if release not in POLICIES.own:
            found[release] = NamedPolicy(IN_TURNS, release)
            found[f"{release} + shortcuts"] = NamedPolicy(SHORTENED, release)
    return found


def _letters(text: str) -> str:
    """Return a name without case and separators."""
    return text.lower().replace(" ", "").replace("_", "-").removesuffix("s")


def parse_policy_name(text: str) -> str:
    """Return the policy name that a text spells, whatever case or separators.

    A plural s is ignored, too: ``asynchronous+shortcut`` is ``asynchronous + shortcuts``.

    Raises:
        RequestError: there is no such policy.
    """
    by_letters = {_letters(name): name for name in named_policies()}
    try:
        return by_letters[_letters(text)]
    except KeyError:
        raise RequestError(
            f"no policy {text!r}", choices=tuple(by_letters.values())
        ) from None


def policy_name(plan: str, release: str) -> str:
    """Return the name of a policy, given the plan and the release.

    The sequential plan, released one task after another, is the baseline ``sequential``. Other
    combinations name both: ``sequential of the plan in slots``.
    """
    plan = IN_TURNS if plan == AT_ONCE else plan
    for name, meant in named_policies().items():
        if meant == (plan, release):
            return name
    if plan == SHORTENED:
        return f"{release} + shortcuts"
    return f"{release} of the plan {plan}"


def plan_folder(plan: str) -> str:
    """Return the name of the folder of a plan."""
    return plan.replace(", ", "-").replace(" ", "-")


def preferred_policy(policies: Sequence[str]) -> str:
    """Return the policy that coordinates best."""
    order = (ASYNCHRONOUS_SHORTCUTS, ASYNCHRONOUS, *named_policies())
    return next(policy for policy in order if policy in policies)
