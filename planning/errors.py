"""Exceptions of the package: a base class, and one subclass for each cause."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import Any, Self


def _with_choices(message: str, choices: tuple[str, ...]) -> str:
    return message + (f" (valid: {', '.join(choices)})" if choices else "")


def _rebuild(
    kind: type[BaseException], args: tuple[Any, ...], attributes: dict[str, Any]
) -> BaseException:
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class TwinError(Exception):
    """Base of every error that a user can cause and fix.

    Attributes:
        message: one sentence that names the place and the offending value.
        choices: the valid alternatives, empty where there are none to list.
    """

    def __init__(self, message: str, *, choices: tuple[str, ...] = ()) -> None:
        self.message = message
        self.choices = choices
        super().__init__(_with_choices(message, choices))

    def __reduce__(self) -> tuple[Any, ...]:
        # Other processes need its attributes, whatever its constructor takes.
        return _rebuild, (type(self), self.args, vars(self))

    def with_message(self, message: str) -> Self:
        """Return the same error, with its attributes, under another message."""
        other = copy(self)
        other.message = message
        other.args = (_with_choices(message, self.choices),)
        return other


class ScenarioError(TwinError):
    """The scenario file cannot be used as written."""


class ShapeError(TwinError):
    """The shape of a part or fixture cannot be used."""


class RobotModelError(TwinError):
    """A robot description cannot be used."""


class FittingError(RobotModelError):
    """A change that a cell makes to a robot does not fit it.

    Attributes:
        key: key of the robot at fault, such as ``tool``, ``flange``, ``limits`` or ``joints``.
    """

    def __init__(
        self, message: str, *, key: str, choices: tuple[str, ...] = ()
    ) -> None:
        self.key = key
        super().__init__(message, choices=choices)


class InfeasibleStepError(TwinError):
    """No robot, object and pose can do an assembly step.

    Attributes:
        steps: numbers of the steps, counted from 1; empty where it is none in particular.
        thing: name of the part or tool at fault, empty where it is none.
        blocked_by: names of objects, fixtures, and arms and tools of robots (``robot/arm``) that are in the way.
    """

    def __init__(
        self,
        message: str,
        *,
        steps: Iterable[int] = (),
        thing: str = "",
        blocked_by: Iterable[str] = (),
    ) -> None:
        self.steps, self.thing = tuple(steps), thing
        self.blocked_by = frozenset(blocked_by)
        super().__init__(message)


class UndecidedError(TwinError):
    """A search reached its limit with neither an answer nor a proof that there is none.

    Attributes:
        visited: number of partial structures that were examined.
    """

    def __init__(self, message: str, *, visited: int) -> None:
        self.visited = visited
        super().__init__(message)


class ConstructionError(TwinError):
    """A construction cannot be built as it is, or by this team.

    Attributes:
        parts: names of the parts at fault, the one to change first; empty where it is none.
        at_start: whether something is wrong before anybody moves.
    """

    def __init__(
        self, message: str, *, parts: Iterable[str] = (), at_start: bool = False
    ) -> None:
        self.parts, self.at_start = tuple(parts), at_start
        super().__init__(message)


class TransitError(TwinError):
    """No collision-free path was found for a transit.

    Attributes:
        step: number of the assembly step that it is for, None where it is for none.
        blocked_by: names of objects, fixtures, and arms and tools of robots (``robot/arm``) that are in the way.
    """

    def __init__(
        self, message: str, *, step: int | None = None, blocked_by: Iterable[str] = ()
    ) -> None:
        self.step, self.blocked_by = step, frozenset(blocked_by)
        super().__init__(message)


class PlanInvariantError(TwinError):
    """A plan breaks a guarantee that it must keep."""


class RequestError(TwinError):
    """A request contradicts itself, or the files it refers to."""


class ArgumentError(RequestError, TypeError):
    """An argument of a function is missing or has a wrong type."""


class OutputError(TwinError):
    """A file or folder cannot be written or read."""


def join_lines(message: str) -> str:
    """Return a message of several lines as one line."""
    lines = (" ".join(line.split()) for line in message.splitlines())
    return "; ".join(filter(None, lines)).replace(":; ", ": ")


def escape_control_characters(text: str) -> str:
    """Return a text with every terminal control character replaced by a question mark."""
    if not isinstance(text, str):
        raise TypeError(f"{text!r} is no text")
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def format_names(names: Sequence[str], most: int = 6) -> str:
    """Return a list of names for a message, with the number omitted where there are too many."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def format_faults(faults: Sequence[str], most: int = 6, *, what: str = "") -> str:
    """Return faults for a message, one per line, with the number omitted."""
    more = len(faults) - most
    return "\n".join(
        [*faults[:most], *([f"and {more} more{what}"] if more > 0 else [])]
    )
