"""Wrong arguments of public functions: an error of the package that names the parameter and what it accepts."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import twin

FUNCTIONS: list[Callable[..., object]] = [
    *(twin.audit, twin.check, twin.compare, twin.explore, twin.load, twin.operate),
    *(twin.plan, twin.read_plan, twin.read_run, twin.replay, twin.resume_study),
    *(twin.run, twin.simulate, twin.study),
]
CASES = [
    (function, parameter)
    for function in FUNCTIONS
    for parameter in inspect.signature(function).parameters
]


class Nothing:
    """Of no type that any function takes."""


def test_every_public_function_is_in_the_table() -> None:
    public = [getattr(twin, name) for name in twin.__all__]
    assert [f for f in public if inspect.isfunction(f) and f not in FUNCTIONS] == []


@pytest.mark.parametrize(
    ("function", "parameter"), CASES, ids=[f"{f.__name__}-{p}" for f, p in CASES]
)
def test_a_wrong_type_is_named(function: Any, parameter: str) -> None:
    needed = {
        name: "nowhere"
        for name, own in inspect.signature(function).parameters.items()
        if own.default is inspect.Parameter.empty
    }
    with pytest.raises(twin.ArgumentError) as caught:
        function(**{**needed, parameter: Nothing()})
    assert isinstance(caught.value, TypeError)
    assert isinstance(caught.value, twin.TwinError)
    said = str(caught.value)
    assert said.startswith(f"{function.__name__}(): {parameter} must be ")
    assert "not Nothing" in said


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: twin.plan(5), "scenario must be"),  # type: ignore[arg-type]
        (lambda: twin.load(5), "must be str, PathLike of str"),  # type: ignore[arg-type]
        (lambda: twin.load(), "missing a required argument: 'scenario'"),  # type: ignore[call-arg]
        (lambda: twin.plan("rss", wrold="x"), "wrold"),  # type: ignore[call-arg]
        (lambda: twin.plan(out_of_service="left"), "out_of_service must be"),
        (lambda: twin.plan(out_of_service=[1]), "out_of_service must be"),  # type: ignore[list-item]
        (lambda: twin.simulate("rss", {1: 2}), "values must be"),  # type: ignore[dict-item]
        (lambda: twin.simulate("rss", seed=True), "seed must be"),
        (lambda: twin.simulate("rss", seed=1.5), "seed must be"),  # type: ignore[arg-type]
        (lambda: twin.load("rearrangement").varied(5), "values must be"),  # type: ignore[arg-type]
    ],
)
def test_what_is_accepted_is_said(call: Any, words: str) -> None:
    with pytest.raises(twin.ArgumentError) as caught:
        call()
    assert words in str(caught.value)


def test_every_error_of_the_package_is_exported() -> None:
    base = twin.TwinError
    for name in twin.__all__:
        found = getattr(twin, name)
        if name.endswith("Error"):
            assert issubclass(found, base), name
    own, bases = {base.__name__}, _classes()
    while more := {k for k, of in bases.items() if own & of} - own:
        own |= more
    assert own <= set(twin.__all__)


def _classes() -> dict[str, set[str]]:
    """Return the bases of each class of the package, by its name."""
    root = Path(twin.__file__).parents[1]
    texts = (
        file.read_text(encoding="utf-8")
        for room in ("planning", "scheduling", "twin")
        for file in (root / room).rglob("*.py")
    )
    found = (
        re.findall(r"^class (\w+)\((.*)\):$", text, re.MULTILINE) for text in texts
    )
    return {name: set(re.findall(r"\w+", of)) for own in found for name, of in own}


def test_keys_of_the_execution_section_may_have_its_name_before_them() -> None:
    case = twin.load("rearrangement")
    short = case.varied({"stalls.rate_per_h": 30.0, "skills.pick.scale": 2})
    keys = {"execution.stalls.rate_per_h": 30.0, "execution.skills.pick.scale": 2}
    assert case.varied(keys).resolved() == short.resolved()
    assert short.sections.execution.stalls.rate_per_h == 30.0
    with pytest.raises(twin.ScenarioError, match="varied twice"):
        case.varied({"execution.latency_s": 1, "latency_s": 2})
    with pytest.raises(twin.ScenarioError, match="execution has no 'execution'"):
        case.varied({"execution.seed": 1})
