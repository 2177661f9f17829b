"""Validation of the arguments of public functions against their type hints."""

from __future__ import annotations

import builtins
import inspect
import os
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from numbers import Integral, Real
from typing import (
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from planning.errors import ArgumentError, join_lines

P = ParamSpec("P")
T = TypeVar("T")

_MOST_SHOWN = 60
"""Characters of a value that are shown in a message."""


def checks_arguments(function: Callable[P, T]) -> Callable[P, T]:
    """Make a function raise ArgumentError for unknown arguments, or of a wrong type."""
    signature = inspect.signature(function)
    hints = cache(lambda: get_type_hints(function, localns=_Names(function)))

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            valid = tuple(name for name in signature.parameters if name != "self")
            raise ArgumentError(
                f"{function.__name__}(): {error}", choices=valid
            ) from None
        for name, value in given.items():
            hint = hints().get(name, Any)
            if not _fits(hint, value):
                shown = join_lines(repr(value))[:_MOST_SHOWN]
                raise ArgumentError(
                    f"{function.__name__}(): {name} must be {_words(hint)}, not {type(value).__name__} {shown}"
                )
        return function(*args, **kwargs)

    return checked


class _ByName(type):
    """Metaclass of placeholders for types that only type checkers import."""

    def __instancecheck__(cls, value: object) -> bool:
        return cls.__name__ in {base.__name__ for base in type(value).__mro__}


class _Names(dict[str, Any]):
    """Namespace of the type hints of a function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(vars(builtins) | function.__globals__)

    def __missing__(self, name: str) -> type:
        return _ByName(name, (), {})


def _fits(hint: Any, value: Any) -> bool:
    """Return whether a value has a type; items of one-time iterators are not checked."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_fits(item, value) for item in inner)
    if origin is Literal:
        return value in inner
    if hint is Any:
        return True
    if hint in (None, type(None)):
        return value is None
    if hint in (int, float):
        wanted = Integral if hint is int else Real
        return isinstance(value, wanted) and not isinstance(value, bool)
    if origin is Callable:
        return callable(value)
    kind: Any = origin or hint
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return kind is not os.PathLike or isinstance(value, os.PathLike)
    if not isinstance(value, kind):
        return False
    if not inner or kind is tuple:
        return True
    if isinstance(value, str | bytes):
        return False
    items: Any = value if isinstance(value, Mapping | Sequence) else ()
    return all(_fits(inner[0], item) for item in items)


def _words(hint: Any) -> str:
    """Return a description of the values of a type."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        names = list(dict.fromkeys(_words(item) for item in inner))
        return " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    if hint in (None, type(None)):
        return "None"
    if origin is Callable:
        return "a function"
    name = getattr(origin or hint, "__name__", str(hint))
    items = [_words(item) for item in inner if item not in (Any, Ellipsis)]
    if not items:
        return name
    return f"{name} of {items[0]}"
