"""The linear program of static equilibrium: rigid bodies, contacts, and as little pull as can be.

Bodies have names, weights and centres; contacts are forces of a known direction at a known point
between two bodies, or between a body and the ground; joints bear forces and torques of any
direction up to a limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, linprog
from scipy.sparse import coo_matrix, csc_matrix, eye, hstack, vstack

from planning.transforms import Array

STANDARD_GRAVITY = 9.80665
"""[m/s^2]."""

_NO_PULL = 1e-9
"""Scores, and shares of forces, below this are rounding."""

_INFEASIBLE = 2
"""Status of scipy's linprog."""

LIMIT = 1.0 + 1e-9
"""Largest score that counts as stable."""


@dataclass(frozen=True)
class StabilityReport:
    """The least pull that keeps every body in balance.

    Attributes:
        score: largest pull over its capacity; ``inf`` when no forces are in balance.
        body: the one at whose contacts less pull would not do, or the one farthest from
            balance; None when no pull is needed.
        pulled: pairs of bodies (None for the ground) whose contacts are pulled, each with the
            largest share of its capacity that is used, the largest first.
    """

    score: float
    body: str | None
    pulled: tuple[tuple[str | None, str | None, float], ...] = ()

    @property
    def stable(self) -> bool:
        """True when no contact is pulled with more than its capacity."""
        return self.score <= LIMIT


class Equilibrium:
    """Forces in balance on rigid bodies, built contact by contact.

    The unit of length is free as long as it is one; forces are in newtons. A contact's force
    along its direction is p - s T with p >= 0 and its capacity T of pull, so that the score s
    is the only variable that ties contacts together: one column, no inequalities but bounds.

    Args:
        centres: centre of mass of each body, shape (3,) each.
        weights: weight of each body [N].
        down: unit vector along which weights act.
    """

    def __init__(
        self,
        centres: Mapping[str, Array],
        weights: Mapping[str, float],
        down: tuple[float, float, float] = (0.0, 0.0, -1.0),
    ) -> None:
        self._names = tuple(centres)
        self._index = {name: k for k, name in enumerate(self._names)}
        self._centres = np.array([centres[name] for name in self._names])
        self._wrench = np.zeros((len(self._names), 6))
        self._wrench[:, :3] = np.outer([weights[name] for name in self._names], down)
        self._points: list[Array] = []
        self._directions: list[Array] = []
        self._turns: list[bool] = []
        self._on: list[tuple[int, int]] = []
        self._bounds: list[tuple[float, float]] = []
        self._pulls: list[float] = []
        self._shared: list[tuple[range, float]] = []

    def add_contact(
        self,
        first: str | None,
        second: str | None,
        point: Array,
        direction: Array,
        *,
        pull: float = 0.0,
        within: float | None = None,
    ) -> None:
        """Add a force along ``direction`` on ``second`` and its reaction on ``first``.

        Args:
            first: a body, None for the ground.
            second: a body, None for the ground.
            point: where it acts, shape (3,).
            direction: of the push on ``second``, shape (3,), unit length.
            pull: capacity T of the opposite force [N]; 0 for a contact that only pushes.
            within: bound of the force in both senses [N], which does not count as pull.
        """
        self._add_column(first, second, point, direction, turns=False)
        self._bounds.append((0.0, np.inf) if within is None else (-within, within))
        self._pulls.append(pull)

    def add_joint(
        self,
        first: str | None,
        second: str | None,
        point: Array,
        *,
        force: float,
        torque: float,
    ) -> None:
        """Add a joint, such as a weld, that bears forces and torques about every axis.

        Args:
            first: a body, None for the ground.
            second: a body, None for the ground.
            point: where it is, shape (3,).
            force: most that it bears along each axis of the world [N]; may be infinite.
            torque: most that it bears about each axis [N times the unit of length].
        """
        for turns, limit in ((False, force), (True, torque)):
            for axis in np.eye(3):
                self._add_column(first, second, point, axis, turns=turns)
                self._bounds.append((-limit, limit))
                self._pulls.append(0.0)

    def _add_column(
        self,
        first: str | None,
        second: str | None,
        point: Array,
        direction: Array,
        *,
        turns: bool,
    ) -> None:
        self._points.append(point)
        self._directions.append(direction)
        self._turns.append(turns)
        self._on.append((self._body(first), self._body(second)))

    def add_load(self, body: str, force: Array, points: Array) -> None:
        """Add a known force on a body that acts at points in shares that balance is free to choose.

        Args:
            body: the body.
            force: shape (3,) [N]; the shares have its direction and add up to it.
            points: where it may act, shape (k, 3).
        """
        k = self._index[body]
        if len(points) == 1:
            self._wrench[k, :3] += force
            self._wrench[k, 3:] += np.cross(points[0] - self._centres[k], force)
            return
        total = float(np.linalg.norm(force))
        first = len(self._points)
        for point in points:
            self.add_contact(None, body, point, force / total)
        self._shared.append((range(first, len(self._points)), total))

    def solve(self) -> StabilityReport:
        """Solve the program.

        Raises:
            RuntimeError: the solver failed, as it should never do.
        """
        if not self._points:
            return StabilityReport(math.inf, self._names[0])
        contacts = vstack([self._matrix(), self._sums()], format="csc")
        pulls = np.array(self._pulls)
        column = csc_matrix((contacts @ -pulls)[:, None])
        matrix = hstack([contacts, column], format="csc")
        cost = np.zeros(matrix.shape[1])
        cost[-1] = 1.0
        result = self._minimise(cost, matrix, [*self._bounds, (0.0, np.inf)])
        if result.status == _INFEASIBLE:
            return StabilityReport(math.inf, self._farthest(matrix))
        if result.status != 0:
            raise RuntimeError(f"equilibrium not solved: {result.message}")
        score = max(0.0, float(result.fun))
        if score < _NO_PULL:
            return StabilityReport(0.0, None)
        price = np.where(pulls > 0.0, pulls * result.lower.marginals[:-1], 0.0)
        pushes = result.x[: len(pulls)] - score * pulls
        return StabilityReport(
            score, self._priciest(price), self._pulled(pushes, pulls)
        )

    def _body(self, name: str | None) -> int:
        return -1 if name is None else self._index[name]

    def _matrix(self) -> csc_matrix:
        """Return the wrench (6 rows a body, about its centre) of each column's unit."""
        points, directions = np.array(self._points), np.array(self._directions)
        turns = np.array(self._turns)[:, None]
        on = np.array(self._on)
        rows, columns, values = [], [], []
        for end, sign in ((0, -1.0), (1, 1.0)):
            k = np.flatnonzero(on[:, end] >= 0)
            along = sign * directions[k]
            force = np.where(turns[k], 0.0, along)
            arm = points[k] - self._centres[on[k, end]]
            moment = np.where(turns[k], along, np.cross(arm, force))
            rows.append((6 * on[k, end][:, None] + np.arange(6)).ravel())
            columns.append(np.repeat(k, 6))
            values.append(np.hstack([force, moment]).ravel())
        entries = np.concatenate(values)
        there = entries != 0.0
        place = (np.concatenate(rows)[there], np.concatenate(columns)[there])
        return coo_matrix(
            (entries[there], place), shape=(self._wrench.size, len(points))
        ).tocsc()

    def _sums(self) -> csc_matrix:
        """Return the rows that add up the shares of each shared load."""
        rows = np.repeat(
            np.arange(len(self._shared)), [len(k) for k, _ in self._shared]
        )
        columns = np.array([c for k, _ in self._shared for c in k], dtype=np.intp)
        shape = (len(self._shared), len(self._points))
        return coo_matrix((np.ones(len(columns)), (rows, columns)), shape=shape).tocsc()

    def _minimise(
        self, cost: Array, matrix: csc_matrix, bounds: list[tuple[float, float]]
    ) -> OptimizeResult:
        # Sparse matrices are accepted; scipy's type stubs do not know it.
        solve: Callable[..., OptimizeResult] = linprog
        totals = [total for _, total in self._shared]
        target = np.concatenate([-self._wrench.ravel(), totals])
        for presolve in (True, False):  # presolving leaves some in doubt
            result = solve(
                *(cost, None, None, matrix, target, bounds, "highs", None),
                {"presolve": presolve},
            )
            if result.status in (0, _INFEASIBLE):
                break
        return result

    def _pulled(
        self, pushes: Array, pulls: Array
    ) -> tuple[tuple[str | None, str | None, float], ...]:
        """Return the pairs of bodies that pull each other, the most strained first."""
        worst: dict[tuple[int, int], float] = {}
        for k in np.flatnonzero((pulls > 0.0) & (pushes < -_NO_PULL)):
            share = float(-pushes[k] / pulls[k])
            worst[self._on[k]] = max(worst.get(self._on[k], 0.0), share)
        names = (*self._names, None)  # the ground has the index -1
        ordered = sorted(worst.items(), key=lambda item: -item[1])
        return tuple((names[a], names[b], share) for (a, b), share in ordered)

    def _priciest(self, price: Array) -> str:
        """Return the body whose contacts below the score depends on most, first of equals."""
        total = np.zeros(len(self._names))
        for k, (first, second) in enumerate(self._on):
            total[second if second >= 0 else first] += price[k]
        return self._names[int(np.flatnonzero(total >= total.max() * (1 - 1e-6))[0])]

    def _farthest(self, matrix: csc_matrix) -> str:
        """Return the body that needs most help from outside for all to be in balance."""
        size = self._wrench.size
        help_ = eye(matrix.shape[0], size)
        helped = hstack([matrix, help_, -help_], format="csc")
        cost = np.concatenate([np.zeros(matrix.shape[1]), np.ones(2 * size)])
        free = [(0.0, np.inf)] * (2 * size)
        result = self._minimise(cost, helped, [*self._bounds, (0.0, np.inf), *free])
        extra = result.x[-2 * size :].reshape(2, len(self._names), 6).sum(axis=(0, 2))
        return self._names[int(np.argmax(extra))]
