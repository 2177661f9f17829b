"""Kernels that only kernels call, made callable from tests."""

from __future__ import annotations

from typing import Any

from numba import njit


def outer(inner: Any) -> Any:
    """Return an inner kernel compiled anew, with what Python needs to call it."""
    return njit(nogil=True)(inner.py_func)
