"""Arithmetic expressions in scenario files, such as ``12000 * robots + 300 * floor_area_m2`` or ``late <= 0.05``.

The text is parsed into a Python syntax tree and evaluated node by node. Everything except arithmetic is rejected, so
a file cannot execute code.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, TypeGuard

_LONGEST = 500

_BINARY: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
_UNARY: Mapping[type[ast.unaryop], Callable[[float], float]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: Mapping[str, Callable[..., float]] = {
    "abs": abs,
    "ceil": math.ceil,
    "floor": math.floor,
    "max": max,
    "min": min,
    "sqrt": math.sqrt,
}
_KEY = "key"
"""The function that gives the value of a key: key('cell.robots.left.base.xyz_m.0')."""

_ORDER: Mapping[type[ast.cmpop], int] = {ast.LtE: 1, ast.Lt: 1, ast.GtE: -1, ast.Gt: -1}

KeyValue = Callable[[str], Any]
"""Returns the value of a key of the scenario."""


class ExpressionError(ValueError):
    """Arithmetic that cannot be read, or has no value."""


@dataclass(frozen=True)
class _Written:
    """Parsed arithmetic over some names.

    Attributes:
        text: as it is written.
        names: that it may take, for messages.
    """

    text: str
    names: tuple[str, ...]

    @cached_property
    def _trees(self) -> tuple[ast.expr, ...]:
        """The syntax trees."""
        return (_parsed(self.text),)

    @cached_property
    def used(self) -> frozenset[str]:
        """The names used."""
        return frozenset().union(*map(_names, self._trees))

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """The scenario keys that it uses."""
        return tuple(key for tree in self._trees for key in _keys(tree))

    def check(self) -> Self:
        """Return it unchanged; ExpressionError if it is invalid or uses other names."""
        for tree in self._trees:
            _check(tree, self.names)
        return self


class Expression(_Written):
    """Arithmetic over some names."""

    def value(self, given: Mapping[str, float], key: KeyValue) -> float:
        """Return the value.

        Args:
            given: numbers by name.
            key: gives the values of keys.

        Raises:
            ExpressionError: it has none, such as after a division by 0.
        """
        return _number(self.text, self._trees[0], given, key)


class Inequality(_Written):
    """A comparison of two expressions, such as ``late <= 0.05``."""

    @cached_property
    def _comparison(self) -> tuple[ast.Compare, int]:
        """The comparison, and 1 if the left side shall be smaller, else -1."""
        tree = _parsed(self.text)
        if not isinstance(tree, ast.Compare) or len(tree.ops) != 1:
            raise ExpressionError(
                f"a comparison such as late <= 0.05 expected, not {self.text!r}"
            )
        sign = _ORDER.get(type(tree.ops[0]))
        if sign is None:
            raise ExpressionError(
                f"{self.text!r} is no comparison by one of <=, <, >= and >"
            )
        return tree, sign

    @cached_property
    def _trees(self) -> tuple[ast.expr, ...]:
        tree, _ = self._comparison
        return tree.left, tree.comparators[0]

    def excess(self, given: Mapping[str, float], key: KeyValue) -> float:
        """Return the violation as a share of the right side; 0 where it holds.

        Raises:
            ExpressionError: a side has no value.
        """
        _, sign = self._comparison
        more, bound = (_number(self.text, side, given, key) for side in self._trees)
        over = sign * (more - bound)
        return max(0.0, over) / (abs(bound) or 1.0)


def _parsed(text: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise ExpressionError(f"an expression has at most {_LONGEST} letters")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError(f"{text!r} cannot be read as arithmetic") from None


def _names(tree: ast.expr) -> frozenset[str]:
    called = {id(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)}
    return frozenset(
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and id(node) not in called
    )


def _keys(tree: ast.expr) -> tuple[str, ...]:
    return tuple(
        str(node.args[0].value)
        for node in ast.walk(tree)
        if _is_key(node) and isinstance(node.args[0], ast.Constant)
    )


def _is_key(node: ast.AST) -> TypeGuard[ast.Call]:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == _KEY
        and len(node.args) == 1
        and not node.keywords
    )


def _check(node: ast.expr, names: Collection[str]) -> None:
    if _is_key(node):
        argument = node.args[0]
        if not isinstance(argument, ast.Constant) or not isinstance(
            argument.value, str
        ):
            raise ExpressionError("key('...') takes one key of the scenario, in quotes")
    elif isinstance(node, ast.Constant):
        if not isinstance(node.value, int | float) or isinstance(node.value, bool):
            raise ExpressionError(f"a number expected, not {node.value!r}")
    elif isinstance(node, ast.Name):
        if node.id not in names:
            valid = ", ".join(names)
            raise ExpressionError(
                f"there is no result {node.id!r} (valid: {valid}, key('...'))"
            )
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        _check(node.left, names)
        _check(node.right, names)
    elif isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        _check(node.operand, names)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id not in _FUNCTIONS or node.keywords or not node.args:
            valid = ", ".join((*_FUNCTIONS, _KEY))
            raise ExpressionError(f"there is no {node.func.id!r} (valid: {valid})")
        for argument in node.args:
            _check(argument, names)
    else:
        raise ExpressionError(
            "only numbers, names of results, + - * / **, brackets and"
            f" {', '.join((*_FUNCTIONS, _KEY))} are arithmetic"
        )


def _number(
    text: str, tree: ast.expr, given: Mapping[str, float], key: KeyValue
) -> float:
    try:
        found = _value(tree, given, key)
    except (ZeroDivisionError, OverflowError, ValueError, TypeError) as error:
        raise ExpressionError(f"{text!r} has no value: {error}") from None
    if not math.isfinite(found):
        raise ExpressionError(f"{text!r} has no value: {found}")
    return found


def _value(node: ast.expr, given: Mapping[str, float], key: KeyValue) -> float:
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        if node.id not in given:
            raise ExpressionError(f"nothing is known of {node.id!r}")
        return float(given[node.id])
    if isinstance(node, ast.BinOp):
        left, right = (_value(n, given, key) for n in (node.left, node.right))
        return _BINARY[type(node.op)](left, right)
    if isinstance(node, ast.UnaryOp):
        return _UNARY[type(node.op)](_value(node.operand, given, key))
    assert isinstance(node, ast.Call)
    assert isinstance(node.func, ast.Name)
    if _is_key(node):
        argument = node.args[0]
        assert isinstance(argument, ast.Constant)
        name = str(argument.value)
        found = key(name)
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise ExpressionError(f"{name} is no number, but {found!r}")
        return float(found)
    return float(_FUNCTIONS[node.func.id](*(_value(n, given, key) for n in node.args)))
