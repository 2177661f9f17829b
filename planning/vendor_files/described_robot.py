"""Robot models made of a description and of what its vendor says in further files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from planning.cell.robot_model import RobotModel
from planning.errors import FittingError, RobotModelError
from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import ROBOTS, robot_model
from planning.vendor_files.vendor_files import with_vendor_files


def described_robot(
    model: str,
    folder: Path,
    fitting: Fitting,
    **given: str | Literal[False] | Mapping[str, str | float | bool],
) -> RobotModel:
    """Return a robot model.

    Args:
        model: name of a registered robot or path of a description.
        folder: where relative paths start.
        fitting: changes of the cell.
        given: keys of the robot, see ``with_vendor_files``.

    Raises:
        RobotModelError: a file cannot be used.
        FittingError: a key of the robot does not fit; the message names it.
    """
    if model in ROBOTS:
        for key in given:
            raise FittingError(f"{model!r} is a registered robot: no {key}", key=key)
        return robot_model(model, folder, fitting)
    file, fitting = with_vendor_files(model, folder, fitting, **given)  # type: ignore[arg-type]
    try:
        return robot_model(file, folder, fitting)
    except RobotModelError as error:  # in words of the source
        raise error.with_message(error.message.replace(file, model)) from None
