"""Policies have one name each, however they are written."""

import pytest

from planning.errors import RequestError
from twin.runs.policies import (
    AT_ONCE,
    IN_SLOTS,
    NAMED_POLICIES,
    SHORTENED,
    parse_policy_name,
    plan_folder,
    policy_name,
)


@pytest.mark.parametrize("name", NAMED_POLICIES)
def test_a_name_means_itself_and_its_parts_have_it(name: str) -> None:
    assert parse_policy_name(name) == name
    assert parse_policy_name(name.replace(" ", "")) == name
    assert policy_name(*NAMED_POLICIES[name]) == name


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("asynchronous+shortcut", "asynchronous + shortcuts"),
        ("asynchronous + shortcut", "asynchronous + shortcuts"),
        ("synchronous + TPG + shortcut", "synchronous + TPG + shortcuts"),
        ("Synchronous+tpg", "synchronous + TPG"),
        ("open_loop", "open-loop"),
    ],
)
def test_older_and_careless_names_are_understood(written: str, name: str) -> None:
    assert parse_policy_name(written) == name


def test_others_are_refused_by_the_names_that_there_are() -> None:
    with pytest.raises(
        RequestError, match=r"'greedy' \(valid: sequential, synchronous"
    ):
        parse_policy_name("greedy")


def test_what_has_no_name_says_how_and_what() -> None:
    assert policy_name(SHORTENED, "open-loop") == "open-loop + shortcuts"
    assert policy_name(IN_SLOTS, "sequential") == "sequential of the plan in slots"
    assert policy_name(AT_ONCE, "asynchronous") == "asynchronous"


def test_plans_have_folders_of_their_own() -> None:
    plans = {policy.plan for policy in NAMED_POLICIES.values()}
    folders = {plan_folder(plan) for plan in plans}
    assert folders == {"in-turns", "shortened", "in-slots", "in-slots-shortened"}
