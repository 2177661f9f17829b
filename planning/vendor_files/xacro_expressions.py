"""Evaluation of the expressions of xacro files: arithmetic, texts, lists and mappings, and a list of functions.

The syntax tree of an expression is interpreted node by node. Attributes of objects are entries of mappings; methods and
functions are entries of one table. No attribute of a Python object can be read, and nothing that is not in the table can be
called. Time and memory are limited by the process, see ``expand_xacro``.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

_MATH = (
    *("acos", "asin", "atan", "atan2", "ceil", "cos", "degrees", "exp", "fabs", "floor", "fmod", "hypot", "isclose"),
    *("isfinite", "log", "log10", "pow", "radians", "sin", "sqrt", "tan", "trunc"),
)  # fmt: skip
_PYTHON = (abs, all, any, bool, dict, float, int, len, list, max, min, round, sorted, str, sum, tuple)  # fmt: skip
_CONSTANTS = {name: getattr(math, name) for name in ("pi", "e", "tau", "inf")}
_CONSTANTS |= {"true": True, "false": False}
_METHODS: tuple[Callable[..., Any], ...] = (
    *(str.endswith, str.join, str.lower, str.replace, str.split, str.startswith, str.strip, str.upper),
    *(dict.get, dict.items, dict.keys, dict.values),
)  # fmt: skip

_PLAIN: dict[str, Callable[..., Any]] = {name: getattr(math, name) for name in _MATH}
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **_PLAIN,
    **{f"math.{name}": function for name, function in _PLAIN.items()},
    **{item.__name__: item for item in _PYTHON},
    **{f"python.{item.__name__}": item for item in _PYTHON},
    **{f".{item.__name__}": item for item in _METHODS},
}
"""Functions that expressions may call; methods begin with a dot and take their object first."""


_HIGHEST_POWER = 100

_ERRORS = (ArithmeticError, AttributeError, LookupError, SyntaxError, TypeError, ValueError)  # fmt: skip


_UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_COMPARING: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, items: item in items,
    ast.NotIn: lambda item, items: item not in items,
}


class XacroExpressionError(Exception):
    """An expression that is not allowed, or has no value."""


def _power(base: float, exponent: float) -> float:
    """Return a power, by floating-point numbers where whole ones would be long."""
    small = abs(exponent) <= _HIGHEST_POWER
    return float(base**exponent if small else math.pow(base, exponent))


class _Interpreter:
    """Interpreter of syntax trees, with values of names and functions; values that can be called are not seen."""

    def __init__(
        self, values: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
    ) -> None:
        self._values, self._functions = values, functions

    def value(self, node: ast.expr | None) -> Any:
        """Return the value of a node; XacroExpressionError where its kind is not allowed."""
        match node:
            case None | ast.Constant(value=None):
                return None
            case ast.Constant(value=bool() | int() | float() | str() as value):
                return value
            case ast.Name(id=name):
                return self._named(name)
            case ast.Attribute(value=ast.Name(id="math"), attr=name) if (
                name in _CONSTANTS
            ):
                return _CONSTANTS[name]
            case ast.Attribute(value=owner, attr=name):
                return self._entry(self.value(owner), name)
            case ast.Subscript(value=owner, slice=ast.Slice() as part):
                bounds = (part.lower, part.upper, part.step)
                return self.value(owner)[slice(*map(self.value, bounds))]
            case ast.Subscript(value=owner, slice=key):
                return self._entry(self.value(owner), self.value(key))
            case ast.List(elts=items):
                return list(map(self.value, items))
            case ast.Tuple(elts=items):
                return tuple(map(self.value, items))
            case ast.Dict(keys=keys, values=values) if None not in keys:
                pairs = zip(map(self.value, keys), map(self.value, values), strict=True)
                return dict(pairs)
            case ast.UnaryOp(op=op, operand=item) if type(op) in _UNARY:
                return _UNARY[type(op)](self.value(item))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return _power(self.value(left), self.value(right))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return _BINARY[type(op)](self.value(left), self.value(right))
            case ast.BoolOp(op=op, values=items):
                return self._joined(items, every=isinstance(op, ast.And))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compared(left, ops, others)
            case ast.IfExp(test=test, body=body, orelse=other):
                return self.value(body if self.value(test) else other)
            case ast.Call():
                return self._called(node)
        raise XacroExpressionError(f"{type(node).__name__} is not allowed")

    def _named(self, name: str) -> Any:
        for known in (self._values, _CONSTANTS):
            # Tables of xacro do not always say that they have what they have.
            with suppress(KeyError):
                if not callable(found := known[name]):
                    return found
        raise XacroExpressionError(f"{name!r} is not defined")

    def _entry(self, owner: Any, key: Any) -> Any:
        found = owner[key]
        if callable(found):
            raise XacroExpressionError(f"{key!r} is not defined")
        return found

    def _joined(self, items: list[ast.expr], *, every: bool) -> Any:
        found: Any = every
        for item in items:
            found = self.value(item)
            if bool(found) is not every:
                break
        return found

    def _compared(
        self, left: ast.expr, ops: list[ast.cmpop], others: list[ast.expr]
    ) -> bool:
        first = self.value(left)
        for op, other in zip(ops, others, strict=True):
            before, first = first, self.value(other)
            if not _COMPARING[type(op)](before, first):
                return False
        return True

    def _called(self, node: ast.Call) -> Any:
        name, items = ast.unparse(node.func), list(map(self.value, node.args))
        if isinstance(node.func, ast.Attribute) and name not in self._functions:
            name = f".{node.func.attr}"
            items.insert(0, self.value(node.func.value))
        if node.keywords or name not in self._functions:
            words = f"{name[:60]!r} is no function that may be called"
            raise XacroExpressionError(words)
        return self._functions[name](*items)


def evaluate(
    text: str, values: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
) -> Any:
    """Return the value of an expression, given values of names and functions that may be called, by name.

    Raises:
        XacroExpressionError: it is no expression, not allowed, or without a value.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
        return _Interpreter(values, functions).value(tree.body)
    except _ERRORS as error:
        raise XacroExpressionError(f"{type(error).__name__}: {error}") from None
