"""Schema of the arrays in plan.npz: type, shape and range, declared as field annotations of dataclasses.

For example, ``duration: Annotated[Array, Column("nodes", least=0.0)]`` is stored as ``<prefix>duration``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

import numpy as np
import numpy.typing as npt

from planning.bounds import FARTHEST_COMPOSED
from planning.errors import OutputError
from planning.transforms import Array

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Column:
    """An array of plan.npz.

    Args:
        shape: sizes, or names of sizes: arrays that are read with the same sizes share them.
        dtype: of its values.
        least, most: range of its values; None for no bound.
        largest: magnitude beyond which no value is believed.
    """

    shape: tuple[int | str, ...]
    dtype: type = np.float64
    least: float | None = None
    most: float | None = None
    largest: float = FARTHEST_COMPOSED

    def read(
        self, name: str, arrays: Mapping[str, npt.NDArray[Any]], sizes: dict[str, int]
    ) -> npt.NDArray[Any]:
        """Return a validated array.

        Args:
            name: of the array.
            arrays: all there are.
            sizes: by name; unknown ones are read from the array.

        Raises:
            OutputError: it has another type or shape than it should, or a value that is not finite
                or out of its range; the message names the array.
            KeyError: it is missing.
        """
        values = arrays[name]
        self.check(name, values, sizes)
        return values

    def check(self, name: str, values: npt.NDArray[Any], sizes: dict[str, int]) -> None:
        """Raise an OutputError unless an array is valid, see ``read``."""
        if values.ndim == len(self.shape):
            for size, count in zip(self.shape, values.shape, strict=True):
                if isinstance(size, str):
                    sizes.setdefault(size, count)
        shape = tuple(sizes.get(s, s) if isinstance(s, str) else s for s in self.shape)
        if values.dtype != self.dtype or values.shape != shape:
            raise OutputError(
                f"{name} is {values.dtype} of shape {values.shape}, not"
                f" {np.dtype(self.dtype)} of shape {shape}"
            )
        if values.dtype.kind == "f":
            require_values(np.isfinite(values), name, values, "is not finite")
            wrong = f"is beyond {self.largest:g}"
            require_values(abs(values) <= self.largest, name, values, wrong)
        if self.least is not None:
            least, most = self.least, np.inf if self.most is None else self.most
            wrong = f"must be at least {least:g}"
            if self.most is not None:
                wrong = f"must be {least:g} to {most:g}"
            require_values((values >= least) & (values <= most), name, values, wrong)
        if self.shape[-2:] == (4, 4):
            _require_poses(name, values)


def columns(kind: type) -> dict[str, Column]:
    """Return the arrays of a data class by the names of its fields."""
    hints = get_type_hints(kind, include_extras=True).items()
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints}
    return {name: column for name, mark in marks.items() for column in mark}


def write_columns(item: Any, prefix: str) -> Arrays:
    """Return the arrays of a data class by their names in plan.npz.

    Raises:
        OutputError: one has values that ``read_columns`` would refuse.
    """
    sizes: dict[str, int] = {}
    arrays: Arrays = {}
    for name, column in columns(type(item)).items():
        arrays[prefix + name] = values = getattr(item, name)
        column.check(prefix + name, values, sizes)
    return arrays


def read_columns(
    kind: type, prefix: str, arrays: Arrays, sizes: dict[str, int]
) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a data class by the names of its fields, see ``Column.read``."""
    return {
        name: column.read(prefix + name, arrays, sizes)
        for name, column in columns(kind).items()
    }


def require_values(
    ok: npt.NDArray[np.bool_], name: str, values: npt.NDArray[Any], wrong: str
) -> None:
    """Refuse an array with invalid values.

    Raises:
        OutputError: one is not; the message says which, what it is, and what is wrong.
    """
    if not np.all(ok):
        place = tuple(np.argwhere(~ok)[0].tolist())
        raise OutputError(f"{name}{list(place)} is {values[place]}: {wrong}")


def _require_poses(name: str, poses: Array) -> None:
    turn = poses[..., :3, :3]
    apart = abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    rigid = (apart < 1e-6) & (np.linalg.det(turn) > 0)
    rigid &= np.all(poses[..., 3, :] == (0.0, 0.0, 0.0, 1.0), axis=-1)
    if not np.all(rigid):
        place = np.argwhere(~rigid)[:1].ravel().tolist()
        raise OutputError(f"{name}{place or ''} is no pose: rotation and translation")
