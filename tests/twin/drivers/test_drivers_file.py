"""Drivers files: what is wrong is told with its line and the valid choices."""

from functools import partial
from pathlib import Path

import pytest

from tests.twin import written as files
from twin.document.validation import InvalidScenarioError
from twin.drivers.drivers_file import (
    FrankaArm,
    ServiceDriver,
    SimulatedDriver,
    read_drivers,
)

ROBOTS = ("left", "right")


written = partial(files.written, name="drivers.yaml")


def test_robots_that_are_not_named_are_simulated(tmp_path: Path) -> None:
    text = "robots: {left: {kind: grpc}}\nlease_s: 1.5\n"
    found = read_drivers(written(tmp_path, text), ROBOTS)
    assert isinstance(found.driver_of("left"), ServiceDriver)
    assert isinstance(found.driver_of("right"), SimulatedDriver)
    assert found.lease_s == 1.5
    arm = "robots: {right: {kind: franka, address: 10.0.0.2}}"
    assert isinstance(
        read_drivers(written(tmp_path, arm), ROBOTS).driver_of("right"), FrankaArm
    )


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (
            "robots: {middle: {kind: grpc}}",
            1,
            "unknown robot 'middle' (valid: left, right)",
        ),
        ("robots:\n  left: {kind: telnet}", 2, "grpc"),
        ("robots:\n  left: {kind: franka}", 2, "'address' is missing"),
        ("lease: 2", 1, "lease_s"),
        ("lease_s: 0", 1, "greater than 0"),
        ("pace: -1", 1, "greater than 0"),
        ("out_s: soon", 1, "number"),
        ("robots: [left]", 1, "robots"),
        ("listen: 7", 1, "text"),
        (
            "pace: 2\nrobots: {left: {kind: franka, address: 10.0.0.2}}",
            1,
            "left is a real robot",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    with pytest.raises(InvalidScenarioError) as caught:
        read_drivers(written(tmp_path, text), ROBOTS)
    told = caught.value.report()
    assert f"drivers.yaml:{line}:" in told
    assert words in told


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenarioError, match="cannot be read"):
        read_drivers(tmp_path / "none.yaml", ROBOTS)
