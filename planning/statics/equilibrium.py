"""The linear program of static equilibrium: rigid bodies and contact forces between them.

One program per structure: six rows a body, a column for every force that a contact can exert. The present
bodies and their loads (a ``LoadCase``) enable columns and set bounds, so that the solver is warm-started
from its last solution. There are two queries: how much of a load the bodies bear, with contacts pulling up
to their capacity (``bears``); and, from scratch, the least pull for equilibrium, and where the bodies fail
first (``least_pull``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import highspy
import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, eye, hstack

from planning.silence import silence_output
from planning.transforms import Array

STANDARD_GRAVITY = 9.80665
"""[m/s^2]."""

ENOUGH = 1e-6
"""A structure bears a force when it bears this much less [N]."""

_NO_PULL = 1e-9
"""Scores, and shares of forces, below this are rounding."""

LIMIT = 1.0 + 1e-9
"""Largest score that counts as stable."""

_STATUS = highspy.HighsModelStatus
_INFEASIBLE = (_STATUS.kInfeasible, _STATUS.kModelEmpty)

_PRIMAL, _DUAL = 4, 1
"""Simplex methods of HiGHS: the primal one takes a quarter of the time of the dual where columns are
switched on and off, but leaves a few programs in doubt that the dual one decides."""

Vector = tuple[float, float, float]

DOWN: Vector = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class ContactForce:
    """A force that two bodies, or a body and the ground, can exert on each other.

    The unit of length is free as long as it is one.

    Attributes:
        first, second: names of the bodies, None for the ground.
        point: where it acts.
        direction: of the push on ``second``, a unit vector; the axis of a torque.
        pull: capacity T of the opposite force [N]; 0 for a contact that only pushes.
        within: bound of the force in both senses [N], or of the torque, which does not count as
            pull; None for a contact that pushes without limit.
        turns: True for a torque.
        share: True for a share of the load of a case.
    """

    first: str | None
    second: str | None
    point: Vector
    direction: Vector
    pull: float = 0.0
    within: float | None = None
    turns: bool = False
    share: bool = False


@dataclass(frozen=True)
class Load:
    """A known force on a body at points, with shares that the equilibrium is free to choose.

    A tool that holds a body keeps it from turning, so what it presses with acts where the body
    resists: anywhere between the points that the tool touches.

    Attributes:
        body: its name.
        force: [N]; the shares have its direction and add up to it.
        points: where it may act.
    """

    body: str
    force: Vector
    points: tuple[Vector, ...]


@dataclass(frozen=True)
class LoadCase:
    """The present bodies of a structure, and the loads on it.

    Attributes:
        present: names of the bodies in their places.
        held: those of them that move no more than the ground does.
        weighing: bodies whose weight counts; all by default.
        down: unit vector along which weights act.
        loose: a body whose contacts push but do not pull.
        pushes: contacts in addition to those of the structure, such as of tools and joints.
        load: a force on one of the bodies.
    """

    present: Collection[str]
    held: Collection[str] = ()
    weighing: Collection[str] | None = None
    down: Vector = DOWN
    loose: str | None = None
    pushes: Sequence[ContactForce] = ()
    load: Load | None = None


@dataclass(frozen=True)
class StabilityReport:
    """The least pull that keeps every body in equilibrium.

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
    """Forces in equilibrium on any of the bodies of a structure.

    Args:
        centres: centre of mass of each body, shape (3,) each.
        weights: weight of each body [N].
        contacts: between them, and with the ground, where all bodies are there.
    """

    def __init__(
        self,
        centres: Mapping[str, Array],
        weights: Mapping[str, float],
        contacts: Sequence[ContactForce],
    ) -> None:
        self._names = tuple(centres)
        self._index = {name: k for k, name in enumerate(self._names)}
        self._centres = np.array([centres[name] for name in self._names])
        self._weights = np.array([weights[name] for name in self._names])
        self._own = len(contacts)
        self._columns: dict[ContactForce, int] = {}
        self._on = np.empty((0, 2), dtype=np.intp)
        self._limits = np.empty((0, 2))
        self._pulls = np.empty(0)
        self._pushing = np.empty(0, dtype=bool)
        self._blocks: list[csc_matrix] = []
        # As the solver knows them now. Row 0 adds up the shares of a load.
        self._bounds = np.empty((0, 2))
        self._rows = np.zeros((1 + 6 * len(self._names), 2))
        self._solver = make_quiet_solver()
        for option, value in (
            ("presolve", "off"),
            ("solver", "simplex"),
            ("simplex_strategy", _PRIMAL),
            ("threads", 1),
        ):
            self._solver.setOptionValue(option, value)
        size, none = len(self._rows), np.array([], dtype=np.int32)
        self._solver.addRows(
            size, *self._rows.T, 0, np.zeros(size, np.int32), none, none
        )
        self._add(contacts)
        self.solved = 0
        """Number of linear programs solved so far."""

    def bears(self, case: LoadCase) -> float:
        """Return the largest part of a load that the bodies can bear [N].

        Returns:
            The force, 0 for no load; -1 where the bodies do not even stand.
        """
        used = self._used(case)
        limits = self._limits.copy()
        limits[self._pulling_contacts(case), 0] = 0.0
        bounds = np.zeros_like(limits)
        bounds[used] = limits[used]
        rows = self._balance(case)
        rows[0, 0] = 0.0
        self._apply(bounds, rows)
        self.solved += 1
        status = self._solve()
        if status in _INFEASIBLE:
            return -1.0
        if status != _STATUS.kOptimal:
            raise RuntimeError(f"equilibrium not solved: {status}")
        return max(0.0, -float(self._solver.getInfo().objective_function_value))

    def least_pull(self, case: LoadCase) -> StabilityReport:
        """Return the pull needed for equilibrium, and where the bodies fail first.

        A contact's force along its direction is p - s T with p >= 0 and its capacity T of pull,
        so that the score s is the only variable that ties contacts together: one column, no
        inequalities but bounds.

        Raises:
            RuntimeError: the solver failed, as it should never do.
        """
        used = self._used(case)
        if not len(used):
            first = min(self._index[n] for n in case.present if n not in case.held)
            return StabilityReport(math.inf, self._names[first])
        pulls = np.where(self._pulling_contacts(case), 0.0, self._pulls)[used]
        low, high = self._limits[used].T
        low = np.where(self._pushing[used], 0.0, low)
        contacts = hstack(self._blocks, "csc")[:, used]
        matrix = hstack([contacts, csc_matrix((contacts @ -pulls)[:, None])], "csc")
        bounds = np.column_stack([[*low, 0.0], [*high, np.inf]])
        rows, cost = self._balance(case), np.zeros(len(bounds))
        cost[-1] = 1.0
        found = _minimised(cost, matrix, bounds, rows)
        if found is None:
            return StabilityReport(math.inf, self._farthest(matrix, bounds, rows))
        values, prices = found
        score = max(0.0, float(values[-1]))
        if score < _NO_PULL:
            return StabilityReport(0.0, None)
        pushes = values[:-1] - score * pulls
        return StabilityReport(
            score,
            self._priciest(self._on[used], pulls * prices[:-1]),
            self._pulled(self._on[used], pushes, pulls),
        )

    def _used(self, case: LoadCase) -> Array:
        """Return the columns of a load case: contacts, further pushes, shares of the load."""
        there = np.zeros(len(self._names) + 1, dtype=bool)
        there[[self._index[name] for name in case.present]] = True
        there[-1] = True  # the ground
        extra = [*case.pushes, *_shares(case.load)]
        self._add([c for c in dict.fromkeys(extra) if c not in self._columns])
        own = np.flatnonzero(there[self._on[: self._own]].all(axis=1))
        return np.array([*own, *(self._columns[c] for c in extra)], dtype=np.intp)

    def _pulling_contacts(self, case: LoadCase) -> Array:
        """Return the contacts that do not pull because of a body that is being inserted."""
        if case.loose is None:
            return np.zeros(len(self._on), dtype=bool)
        loose = (self._on == self._index[case.loose]).any(axis=1)
        return np.asarray(loose & self._pushing)

    def _balance(self, case: LoadCase) -> Array:
        """Return the bounds of all rows: the required sums of forces on the bodies."""
        rows = np.zeros_like(self._rows)
        if case.load is not None:
            rows[0] = np.linalg.norm(case.load.force)
        heavy = case.present if case.weighing is None else case.weighing
        on = [self._index[name] for name in case.present if name in heavy]
        wrench = rows[1:].reshape(len(self._names), 6, 2)
        wrench[on, :3] = -(self._weights[on, None] * case.down)[:, :, None]
        wrench[[self._index[name] for name in case.held]] = -np.inf, np.inf
        return rows

    def _apply(self, bounds: Array, rows: Array) -> None:
        """Update the solver by the differences from the last case."""
        k = np.flatnonzero((bounds != self._bounds).any(axis=1)).astype(np.int32)
        self._solver.changeColsBounds(len(k), k, *bounds[k].T.copy())
        k = np.flatnonzero((rows != self._rows).any(axis=1)).astype(np.int32)
        self._solver.changeRowsBounds(len(k), k, *rows[k].T.copy())
        self._bounds, self._rows = bounds, rows

    def _solve(self) -> Any:
        """Solve the program warm-started; from scratch where that fails."""
        self._solver.run()
        for strategy in (_PRIMAL, _DUAL):
            if self._solver.getModelStatus() in (*_INFEASIBLE, _STATUS.kOptimal):
                break
            self._solver.clearSolver()
            self._solver.setOptionValue("simplex_strategy", strategy)
            self._solver.run()
        self._solver.setOptionValue("simplex_strategy", _PRIMAL)
        return self._solver.getModelStatus()

    def _add(self, contacts: Sequence[ContactForce]) -> None:
        """Add disabled columns to the program."""
        if not contacts:
            return
        known = enumerate(contacts, len(self._on))
        self._columns |= {c: k for k, c in known}
        on = [[self._body(c.first), self._body(c.second)] for c in contacts]
        limits = [
            (-c.pull, np.inf) if c.within is None else (-c.within, c.within)
            for c in contacts
        ]
        self._on = np.vstack([self._on, on])
        self._limits = np.vstack([self._limits, limits])
        self._pulls = np.append(self._pulls, [c.pull for c in contacts])
        pushing = [c.within is None for c in contacts]
        self._pushing = np.append(self._pushing, pushing)
        self._bounds = np.vstack([self._bounds, np.zeros((len(contacts), 2))])
        matrix = self._wrenches(contacts)
        self._blocks.append(matrix)
        zeros = np.zeros(len(contacts))
        cost = -np.array([float(c.share) for c in contacts])
        self._solver.addCols(
            *(len(contacts), cost, zeros, zeros),
            *(matrix.nnz, matrix.indptr[:-1], matrix.indices, matrix.data),
        )

    def _body(self, name: str | None) -> int:
        return -1 if name is None else self._index[name]

    def _wrenches(self, contacts: Sequence[ContactForce]) -> csc_matrix:
        """Return the column of each unit force: its share, and six rows for each body."""
        points = np.array([c.point for c in contacts])
        directions = np.array([c.direction for c in contacts])
        turns = np.array([[c.turns] for c in contacts])
        on = np.array([[self._body(c.first), self._body(c.second)] for c in contacts])
        rows, columns, values = [], [], []
        for end, sign in ((0, -1.0), (1, 1.0)):
            k = np.flatnonzero(on[:, end] >= 0)
            along = sign * directions[k]
            force = np.where(turns[k], 0.0, along)
            arm = points[k] - self._centres[on[k, end]]
            moment = np.where(turns[k], along, np.cross(arm, force))
            rows.append((1 + 6 * on[k, end][:, None] + np.arange(6)).ravel())
            columns.append(np.repeat(k, 6))
            values.append(np.hstack([force, moment]).ravel())
        shares = np.flatnonzero([c.share for c in contacts])
        rows.append(np.zeros_like(shares))
        columns.append(shares)
        values.append(np.ones(len(shares)))
        entries = np.concatenate(values)
        there = entries != 0.0
        place = (np.concatenate(rows)[there], np.concatenate(columns)[there])
        matrix = coo_matrix((entries[there], place), (len(self._rows), len(contacts)))
        return matrix.tocsc()

    def _pulled(
        self, on: Array, pushes: Array, pulls: Array
    ) -> tuple[tuple[str | None, str | None, float], ...]:
        """Return the pairs of bodies that pull each other, most strained first."""
        worst: dict[tuple[int, int], float] = {}
        for k in np.flatnonzero((pulls > 0.0) & (pushes < -_NO_PULL)):
            pair = (int(on[k, 0]), int(on[k, 1]))
            worst[pair] = max(worst.get(pair, 0.0), float(-pushes[k] / pulls[k]))
        names = (*self._names, None)  # the ground has the index -1
        ordered = sorted(worst.items(), key=lambda item: -item[1])
        return tuple((names[a], names[b], share) for (a, b), share in ordered)

    def _priciest(self, on: Array, price: Array) -> str:
        """Return the body whose contacts below affect the score most, first of equals."""
        total = np.zeros(len(self._names))
        np.add.at(total, np.where(on[:, 1] >= 0, on[:, 1], on[:, 0]), price)
        return self._names[int(np.flatnonzero(total >= total.max() * (1 - 1e-6))[0])]

    def _farthest(self, matrix: csc_matrix, bounds: Array, rows: Array) -> str:
        """Return the body that needs most external force for all to be in equilibrium."""
        size = len(rows) - 1
        help_ = eye(len(rows), size, -1)
        helped = hstack([matrix, help_, -help_], format="csc")
        free = np.tile([0.0, np.inf], (2 * size, 1))
        cost = np.concatenate([np.zeros(len(bounds)), np.ones(2 * size)])
        found = _minimised(cost, helped, np.vstack([bounds, free]), rows)
        assert found is not None, "help from outside balances everything"
        extra = found[0][-2 * size :].reshape(2, len(self._names), 6).sum(axis=(0, 2))
        return self._names[int(np.argmax(extra))]


def _shares(load: Load | None) -> list[ContactForce]:
    """Return the forces whose sum is a load."""
    if load is None:
        return []
    x, y, z = (np.array(load.force) / np.linalg.norm(load.force)).tolist()
    return [
        ContactForce(None, load.body, point, (x, y, z), share=True)
        for point in load.points
    ]


def _minimised(
    cost: Array, matrix: csc_matrix, bounds: Array, rows: Array
) -> tuple[Array, Array] | None:
    """Return the solution of a linear program, and its dual values; None if there is none."""
    program = highspy.HighsLp()
    program.num_row_, program.num_col_ = matrix.shape
    program.col_cost_ = cost
    program.col_lower_, program.col_upper_ = bounds.T.copy()
    program.row_lower_, program.row_upper_ = rows.T.copy()
    program.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    program.a_matrix_.start_ = matrix.indptr
    program.a_matrix_.index_ = matrix.indices
    program.a_matrix_.value_ = matrix.data
    solver = make_quiet_solver()
    solver.setOptionValue("threads", 1)
    # Presolving leaves some in doubt, and the dual simplex a few more.
    for presolve, strategy in (("on", _DUAL), ("off", _DUAL), ("off", _PRIMAL)):
        solver.setOptionValue("presolve", presolve)
        solver.setOptionValue("simplex_strategy", strategy)
        solver.passModel(program)
        solver.run()
        status = solver.getModelStatus()
        if status == _STATUS.kOptimal:
            found = solver.getSolution()
            return np.array(found.col_value), np.array(found.col_dual)
        if status in _INFEASIBLE:
            return None
    raise RuntimeError(f"equilibrium not solved: {status}")


def make_quiet_solver() -> Any:
    """Return a solver that prints nothing."""
    new_solver: Callable[[], Any] = highspy.Highs
    with silence_output():
        solver = new_solver()
    solver.setOptionValue("output_flag", False)
    return solver
