"""Solvers are made in silence, also by a HiGHS that greets."""

import os

import highspy
import pulp
import pytest

from planning.silence import QuietHighs
from planning.statics.equilibrium import make_quiet_solver


class Greeting(highspy.Highs):
    """HiGHS as it is since 1.16."""

    def __init__(self) -> None:
        os.write(1, b"Running HiGHS\n")
        super().__init__()  # type: ignore[no-untyped-call]  # highspy has no types


def test_solvers_do_not_greet(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(highspy, "Highs", Greeting)
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    assert "Running HiGHS" in capfd.readouterr().out
    solver = make_quiet_solver()
    assert isinstance(solver, Greeting)
    solver.addVar(0.0, 1.0)
    solver.changeColCost(0, -1.0)
    solver.run()
    assert solver.getObjectiveValue() == -1.0
    program = pulp.LpProblem("most", pulp.LpMaximize)
    x = program.add_variable("x", 0, 3)
    program += x
    program.solve(QuietHighs(timeLimit=10.0))
    assert x.value() == 3.0
    assert isinstance(program.solverModel, Greeting)
    assert capfd.readouterr() == ("", "")
