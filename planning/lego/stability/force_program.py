"""The linear program of equilibrium of one design, kept and changed: which forces does it bear?

One program for all partial structures of a design: six rows a brick, a column for every contact
that the design can have. A partial structure switches columns on and off, so that the solver
starts each time from where it ended the last time. Contacts pull up to their friction (a score of
1 in ``stability``); what is maximised is the force that a tool presses with, up to a limit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import highspy
import numpy as np

from planning.highs import new_highs
from planning.lego.bricks.assembly import STUD_PITCH, PlacedBrick
from planning.lego.bricks.contacts import centre
from planning.lego.stability.stability import (
    UP,
    Contact,
    Hold,
    Load,
)
from planning.statics.equilibrium import STANDARD_GRAVITY
from planning.transforms import Array

_STATUS = highspy.HighsModelStatus

ENOUGH = 1e-6
"""A structure bears a force when it bears this much less [N]."""

_Key = tuple[str, float, tuple[float, float, float], bool]


class ForceProgram:
    """Largest force that the partial structures of a design bear.

    Args:
        bricks: of the design, by name.
        contacts: between them, and with the plate.
    """

    def __init__(
        self, bricks: Mapping[str, PlacedBrick], contacts: Sequence[Contact]
    ) -> None:
        self._index = {name: k for k, name in enumerate(bricks)}
        self._centres = np.array([centre(item) for item in bricks.values()])
        self._weights = np.array(
            [item.brick.mass * STANDARD_GRAVITY for item in bricks.values()]
        )
        self._first = np.array([self._body(c.first) for c in contacts], np.intp)
        self._second = np.array([self._body(c.second) for c in contacts], np.intp)
        self._lower = np.array([-(c.within or c.pull) for c in contacts])
        self._upper = np.array([c.within or highspy.kHighsInf for c in contacts])
        self._solver = new_highs()
        for option, value in (
            ("presolve", "off"),
            ("solver", "simplex"),
            # Primal: a quarter of the time of the dual, where columns are switched on and off.
            ("simplex_strategy", 4),
            ("threads", 1),
        ):
            self._solver.setOptionValue(option, value)
        # Row 0 adds up the pressing forces; then come the six of each brick.
        rows = 1 + 6 * len(self._index)
        zeros = np.zeros(rows)
        none = np.array([], dtype=np.int32)
        self._solver.addRows(
            rows, zeros, zeros, 0, np.zeros(rows, np.int32), none, none
        )
        for c in contacts:
            self._add_column(c, pressing=False)
        self._tools: dict[_Key, int] = {}
        self._low = np.zeros(len(contacts))
        self._high = np.zeros(len(contacts))
        self._there = np.zeros(len(self._index), dtype=bool)
        self._weighs = True
        self.solved = 0
        """Number of linear programs solved so far."""

    def bears(
        self,
        names: Iterable[str],
        *,
        load: Load | None = None,
        holds: Sequence[Hold] = (),
        weightless: bool = False,
    ) -> float:
        """Return the largest force that a partial structure bears, up to that of a load [N].

        Args:
            names: the bricks that are there.
            load: a brick that is pressed: its joints push but do not pull yet. None for none.
            holds: tools that stand still against bricks.
            weightless: leave the weight of the bricks out: what a structure does not bear then,
                no structure of fewer of its bricks bears.

        Returns:
            The force, 0 for no load; -1 where the structure does not even stand.
        """
        there = np.zeros(len(self._index), dtype=bool)
        there[[self._index[name] for name in names]] = True
        total = 0.0 if load is None else float(np.linalg.norm(load.force))
        low, high = self._bounds(there, load, holds)
        self._apply(there, low, high, weighs=not weightless)
        self._solver.changeRowBounds(0, 0.0, total)
        self.solved += 1
        status = self._solve()
        if status in (_STATUS.kInfeasible, _STATUS.kModelEmpty):
            return -1.0
        if status != _STATUS.kOptimal:
            raise RuntimeError(f"equilibrium not solved: {status}")
        return max(0.0, -float(self._solver.getInfo().objective_function_value))

    def _solve(self) -> Any:
        """Solve the program from where the last one ended, anew where that leads nowhere."""
        known = (_STATUS.kOptimal, _STATUS.kInfeasible, _STATUS.kModelEmpty)
        self._solver.run()
        status = self._solver.getModelStatus()
        if status not in known:
            self._solver.clearSolver()
            self._solver.run()
            status = self._solver.getModelStatus()
        return status

    def _bounds(
        self, there: Array, load: Load | None, holds: Sequence[Hold]
    ) -> tuple[Array, Array]:
        """Return the bounds of all columns in a partial structure."""
        tools = []
        if load is not None:
            direction = float(np.sign(load.force[2]))
            tools += [self._tool(load.brick, direction, p, True) for p in load.points]
        tools += [
            self._tool(h.brick, float(h.direction), h.point, False) for h in holds
        ]
        count = len(self._first)
        on = np.append(there, True)  # the plate, of index -1
        active = on[self._first] & on[self._second]
        low, high = np.zeros(len(self._low)), np.zeros(len(self._low))
        low[:count] = np.where(active, self._lower, 0.0)
        high[:count] = np.where(active, self._upper, 0.0)
        if load is not None:
            loose = self._index[load.brick]
            own = (self._first == loose) | (self._second == loose)
            pulls = own & np.isinf(self._upper)
            low[:count][pulls] = 0.0
        high[tools] = highspy.kHighsInf
        return low, high

    def _apply(self, there: Array, low: Array, high: Array, *, weighs: bool) -> None:
        """Tell the solver what is different from the last time."""
        changed = np.flatnonzero((low != self._low) | (high != self._high))
        if changed.size:
            index = changed.astype(np.int32)
            self._solver.changeColsBounds(
                len(index), index, low[changed], high[changed]
            )
        self._low, self._high = low, high
        different = there != self._there
        if weighs != self._weighs:
            different = np.ones(len(there), dtype=bool)
        for k in np.flatnonzero(different):
            weight = float(self._weights[k]) if there[k] and weighs else 0.0
            self._solver.changeRowBounds(1 + 6 * int(k) + 2, weight, weight)
        self._there, self._weighs = there, weighs

    def _tool(
        self,
        brick: str,
        direction: float,
        point: tuple[float, float, float],
        pressing: bool,
    ) -> int:
        """Return the column of a push of a tool on a brick, which is added if it is new."""
        key = (brick, direction, point, pressing)
        known = self._tools.get(key)
        if known is None:
            known = self._tools[key] = len(self._low)
            at = np.array(point) / STUD_PITCH
            self._add_column(
                Contact(None, brick, at, UP * direction), pressing=pressing
            )
            self._low = np.append(self._low, 0.0)
            self._high = np.append(self._high, 0.0)
        return known

    def _add_column(self, contact: Contact, *, pressing: bool) -> None:
        """Add a contact to the program, switched off."""
        rows: list[int] = []
        values: list[float] = []
        if pressing:
            rows.append(0)
            values.append(1.0)
        for name, sign in ((contact.first, -1.0), (contact.second, 1.0)):
            if name is not None:
                body = self._index[name]
                force = sign * contact.direction
                arm = contact.point - self._centres[body]
                for k, value in enumerate((*force, *np.cross(arm, force))):
                    if value != 0.0:
                        rows.append(1 + 6 * body + k)
                        values.append(float(value))
        order = np.argsort(rows, kind="stable")
        self._solver.addCol(
            -1.0 if pressing else 0.0,
            0.0,
            0.0,
            len(rows),
            np.array(rows, dtype=np.int32)[order],
            np.array(values)[order],
        )

    def _body(self, name: str | None) -> int:
        return -1 if name is None else self._index[name]
