"""Handovers in the air between robots that drivers move: whose hand closes when, by drivers that note it."""

from pathlib import Path

import numpy as np
import pytest

import twin
from planning.cell.workcell import PlacedRobot
from planning.transforms import Array
from scheduling.graph.actuations import actuation_nodes
from tests.twin.live.handed_bar import BAR
from twin.audits.case import moved_spans
from twin.audits.motion.executed import SETTLING, RobotRows
from twin.drivers.driver import ClearedNode, DriverState, ToolOrder, cleared_node
from twin.drivers.simulated_arm import SimulatedArm
from twin.live.link import AwaitedActuation, Link
from twin.live.session import Session

pytestmark = pytest.mark.timeout(300)


class NotingArm(SimulatedArm):
    """An arm that notes when its tool closes for another robot, and how far it is then."""

    misses = False

    def __init__(self, pace: float) -> None:
        super().__init__(pace=pace)
        self.orders: list[tuple[ToolOrder, DriverState, int]] = []

    def act(self, order: ToolOrder) -> None:
        self.orders.append((order, self.state(), self._first + len(self._nodes)))
        super().act(order)
        if self.misses:
            self._words = "the hand did not close at a"


def operated(
    folder: Path, monkeypatch: pytest.MonkeyPatch, *, misses: bool = False
) -> tuple[twin.RunResult, dict[str, NotingArm]]:
    arms: dict[str, NotingArm] = {}

    def driver(self: Session, robot: PlacedRobot) -> NotingArm:
        arms[robot.name] = arm = NotingArm(self.drivers.pace)
        arm.misses = misses
        return arm

    monkeypatch.setattr(Session, "driver", driver)
    (folder / "bar.yaml").write_text(BAR)
    (folder / "drivers.yaml").write_text("pace: 20\n")
    done = twin.operate(
        folder / "bar.yaml",
        drivers=folder / "drivers.yaml",
        out=folder / "run",
        recording=False,
    )
    return done, arms


def test_the_receiver_closes_while_both_stand_and_before_the_giver_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, arms = operated(tmp_path, monkeypatch)
    assert done.outcome == "completed"
    assert done.summary["audit"]["violations"] == []
    giver = done.tpg.chain_index["left"]
    acts = actuation_nodes(done.tpg)[giver]
    (node,) = (k for k, act in acts.items() if act.robot == "right")
    assert (acts[node].act, acts[node + 1].act) == ("close", "open")
    assert arms["left"].orders == []
    # The receiver stands at the end of all that it has, and the giver has not been told to go on.
    ((order, state, given),) = arms["right"].orders
    assert order == ToolOrder(f"left:{node}", "close", order.seconds, "a")
    assert order.seconds == pytest.approx(0.8)
    assert (state.begun, state.done) == (given, given)
    assert done.record is not None
    start, end = done.record.start_ns[giver], done.record.end_ns[giver]
    assert end[node] - start[node] >= 0.8e9
    assert end[node] <= start[node + 1]
    # The giver knows nothing of it, and does not stand there twice.
    told = cleared_node(done.tpg, giver, node, acts)
    assert (told.act, told.seconds.tolist()) == ("", [0.0])


def test_a_hand_that_does_not_close_ends_the_run_with_the_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, arms = operated(tmp_path, monkeypatch, misses=True)
    assert done.outcome == "failed"
    told = {(e.robot, e.kind, e.detail) for e in done.history}
    assert ("right", "stopped", "the hand did not close at a") in told
    # Nobody has let go.
    acts = actuation_nodes(done.tpg)[done.tpg.chain_index["left"]]
    (opens,) = (
        k for k, act in acts.items() if (act.act, act.robot) == ("open", "left")
    )
    assert arms["left"].state().done < opens


def straight(node: int) -> ClearedNode:
    points: Array = np.array([[float(node + 1)]])
    return ClearedNode(node, 0, "transit", "", points, np.array([1.0]))


def test_nodes_after_what_another_hand_does_are_kept_back_until_then() -> None:
    link = Link("run", "left", np.zeros(1))
    awaited = AwaitedActuation(2, "right", ToolOrder("left:2", "close", 0.8))
    link.awaited.append(awaited)
    link.clear([straight(k) for k in range(4)])

    def told() -> list[int]:
        command = link.command(0.0)
        assert command is not None
        return [node.node for node in command.nodes]

    assert told() == [0, 1]
    assert not link.is_due(awaited)
    link.done = 2
    assert link.is_due(awaited)
    link.send_awaited(awaited)
    assert told() == [2, 3]
    # What is planned anew before it is another matter.
    link.awaited.append(awaited)
    link.swap(2, 2)
    assert link.awaited == []


@pytest.mark.parametrize(("still", "over"), [(SETTLING, 1.0), (1e-9, 3.0)])
def test_a_robot_that_is_pushed_while_it_stands_is_through_with_its_node(
    still: float, over: float
) -> None:
    tpg = twin.plan("tray").tpg
    chain = tpg.chains[0]
    q = np.stack([chain.start + x for x in (0.0, 0.1, 0.101, 0.101, 0.2)])
    rows = RobotRows(
        np.array([0.0, 1.0, 3.0, 3.0, 4.0]), q, np.array([0, 0, 0, 1, 1]), still=still
    )
    rest = {
        own.robot: RobotRows(np.zeros(1), own.start[None], np.full(1, -1))
        for own in tpg.chains[1:]
    }
    spans = moved_spans(tpg, {chain.robot: rows, **rest})[chain.robot]
    assert spans.end[0] == over
    assert spans.begin[1] == 3.0
    assert rows.stands(1.0, 3.0) == (still == SETTLING)
