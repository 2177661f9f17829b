"""Drivers in processes of their own: whom the service lets in, and what it believes of them."""

import itertools
import random
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from planning.errors import RequestError, TwinError
from tests.twin.live.false_reports import FALSE
from tests.twin.live.test_execution import PACE, placed, plan, require_order
from tests.twin.live.test_messages import START, some_nodes
from tests.twin.sockets import listening
from twin.cluster.certificates import Certificates, make_certificates
from twin.drivers.driver import ToolOrder
from twin.drivers.simulated_arm import SimulatedArm
from twin.engine.execution import Ports
from twin.live import service as live_service
from twin.live.driver_end import DriverEnd
from twin.live.link import Link
from twin.live.messages import Command, Report
from twin.live.remote_robots import RemoteRobots
from twin.live.service import METHOD, Service, channel_to, drive_remotely
from twin.live.wire_format import (
    DESCRIPTION,
    MOST_BYTES,
    MessageError,
    command_bytes,
    read_command,
    read_report,
    report_bytes,
)
from twin.operations.operation import Operation, operate
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import scenario_execution

__all__ = ["plan"]

pytestmark = pytest.mark.timeout(300)

grpc = pytest.importorskip("grpc")

ANY = "127.0.0.1:0"


@pytest.fixture
def service() -> Iterator[Service]:
    own = Service(ANY)
    own.start()
    yield own
    own.stop()


def operated(plan: PlanResult, service: Service) -> Operation:
    """Operate a plan whose robots' drivers ask for them at a service."""
    links, wires = {}, {}
    for robot in plan.tpg.cell.robots:
        links[robot.name] = Link("run", robot.name, robot.home, lease_s=10.0)
        wires[robot.name] = service.wire(robot.name, robot.model.dof)
    case = plan.scenario
    robots = partial(
        RemoteRobots,
        links=links,
        wires=wires,
        written=lambda: None,
        out_s=120.0,
        pace=PACE,
    )
    model = scenario_execution(case.sections, case.folder)
    return operate(
        case.sections, plan.motions, plan.tpg, model, seed=0, ports=Ports(robots)
    )


def test_drivers_of_another_language_and_another_process_build_together(
    plan: PlanResult, service: Service
) -> None:
    """One is made of ``cell.proto`` alone; npm's packages must be there, or to be had."""
    node = shutil.which("node")
    modules = node_modules()
    if node is None or modules is None:
        pytest.skip("needs node, with @grpc/grpc-js and @grpc/proto-loader")
    address, file = f"127.0.0.1:{service.port}", Path(__file__).with_name("driver.mjs")
    proto = DESCRIPTION.with_name("cell.proto")
    words = (node, file, proto, address, "left", str(PACE), modules)
    others = (sys.executable, "-m", "twin.cli", "drive", address, "right")
    with (
        subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as javascript,
        subprocess.Popen([*others, "--pace", str(PACE), "--quiet"]) as python,
    ):
        done = operated(plan, service)
        assert javascript.wait() == 0
        assert python.wait() == 0
    assert done.record.outcome == "completed"
    assert placed(done) == [1, 2, 3, 4]
    require_order(done)
    measured = done.record.measured["left"]
    chain = done.tpg.chains[done.tpg.chain_index["left"]]
    assert np.allclose(measured.q[-1], chain.waypoints[-1], atol=1e-9)


def node_modules() -> Path | None:
    """Return a folder in which node finds its packages of gRPC; they are fetched once where npm can."""
    folder = Path(__file__).parents[3] / ".pytest_cache" / "node"
    if (folder / "node_modules" / "@grpc" / "proto-loader").is_dir():
        return folder
    if shutil.which("npm") is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    words = ["npm", "install", "--silent", "--no-audit", "--no-fund"]
    packages = ["@grpc/grpc-js@1", "@grpc/proto-loader@0.8"]
    try:
        subprocess.run(
            [*words, *packages], cwd=folder, check=True, capture_output=True, timeout=30
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        return None
    return folder


def asked(address: str, held: Certificates | None, robot: str = "left") -> object:
    """Return how a driver that asks for a robot is refused, None where it is let in."""
    report = report_bytes(
        DriverEnd(SimulatedArm(stands=np.zeros(6)), robot, 1).report()
    )
    with channel_to(address, held) as channel:
        try:
            message = channel.stream_stream(METHOD)(iter([report]), timeout=60.0)
            list(message)
        except grpc.RpcError as error:
            return error.code()
    return None


def test_who_has_no_certificate_or_a_foreign_or_an_old_one_is_refused(
    tmp_path: Path,
) -> None:
    own, foreign = (make_certificates(tmp_path / k, 1) for k in ("own", "foreign"))
    service = Service(ANY, own)
    service.wire("left", 6)
    service.start()
    address = f"127.0.0.1:{service.port}"
    try:
        assert asked(address, own) is None
        assert asked(address, own, "middle") == grpc.StatusCode.NOT_FOUND
        nobody = grpc.StatusCode.UNAVAILABLE
        assert asked(address, None) == nobody
        assert asked(address, foreign) == nobody
        # One that the right authority would let in, shown by who has another one's key.
        mixed = Certificates(own.authority, foreign.certificate, foreign.key)
        assert asked(address, mixed) == nobody
        old = expired(make_certificates(tmp_path / "old", 1))
        service_of_old = Service(ANY, old)
        service_of_old.wire("left", 6)
        service_of_old.start()
        assert asked(f"127.0.0.1:{service_of_old.port}", old) == nobody
        service_of_old.stop()
    finally:
        service.stop()


def expired(held: Certificates) -> Certificates:
    """Put an authority, and a certificate that ended yesterday, in the place of others."""
    request, key = (held.key.with_name(name) for name in ("request.pem", "ca-key.pem"))
    new = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    new += ["-subj", "/CN=assembly-twin cluster"]
    signed = ["-in", request, "-CA", held.authority, "-CAkey", key, "-CAcreateserial"]
    for words in (
        ["req", "-x509", *new, "-keyout", key, "-out", held.authority],
        ["req", "-new", *new, "-keyout", held.key, "-out", request],
        ["x509", "-req", *signed, "-days", "-1", "-out", held.certificate],
    ):
        message = ["openssl", *map(str, words)]
        subprocess.run(message, check=True, capture_output=True)
    return held


def test_it_listens_on_this_machine_unless_both_sides_have_certificates(
    service: Service,
) -> None:
    ports = listening()
    assert ("127.0.0.1", service.port) in ports
    assert {host for host, port in ports if port == service.port} == {"127.0.0.1"}
    with pytest.raises(RequestError, match="is not on this machine"):
        Service("0.0.0.0:0")
    with pytest.raises(RequestError, match="is not on this machine"):
        channel_to("10.0.0.7:50551", None)
    with pytest.raises(RequestError, match=f"listen: 127.0.0.1:{service.port}"):
        Service(f"127.0.0.1:{service.port}")


def test_what_is_no_message_is_left_aside_and_changes_nothing(
    service: Service,
) -> None:
    """Two thousand messages that are broken, between ones that are not."""
    wire, rng, heard = service.wire("left", 2), random.Random(7), list[Report]()
    wire._deliver = heard.append
    end = DriverEnd(SimulatedArm(lambda: 0.0), "left", 1, lambda: 0.0)
    link = Link("run", "left", START)
    link.clear(some_nodes(rng, 3))
    command = link.command(0.0)
    assert command is not None
    end.receive(replace(command, instance=1))
    whole = report_bytes(end.report())
    broken: list[bytes] = []
    while len(broken) < 2000:
        one = bytearray(whole)
        for _ in range(rng.randint(1, 6)):
            one[rng.randrange(len(one))] = rng.randrange(256)
        broken.append(bytes(one[: rng.randint(1, len(one))]))
    with channel_to(f"127.0.0.1:{service.port}", None) as channel:
        message = channel.stream_stream(METHOD)(iter([whole, *broken, whole]))
        while not (heard and heard[-1].number == 1):
            time.sleep(0.05)
        message.cancel()
    before = replace(link)
    for report in heard:
        assert report.robot == "left"
        link.receive(report, 1.0)
        # Whatever it says, what it may pass stays as it was.
        assert link.cleared == before.cleared
        assert 0 <= link.done <= len(link.cleared)


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_messages_are_the_same_after_they_were_bytes(seed: int, count: int) -> None:
    rng = random.Random(seed)
    link = Link("run", "left", START, number=rng.randrange(2**40))
    link.clear(some_nodes(rng, count))
    if rng.random() < 0.5:
        link.order(ToolOrder("right:7", "close", rng.random(), "bar"))
    command = link.command(0.0)
    assert command is not None
    again = read_command(command_bytes(command))
    assert same(again, command)
    end = DriverEnd(SimulatedArm(lambda: 0.0), "left", 0)
    end.receive(again)
    report = end.report()
    if rng.random() < 0.5:
        state = replace(
            report.state, failed=rng.randint(0, 9), words="no grip", acted="right:7"
        )
        report = replace(report, state=state)
    assert same(read_report(report_bytes(report), 2), report)


def same(one: Any, other: Any) -> bool:
    """Tell whether two messages say the same."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(v, getattr(other, k)) for k, v in vars(one).items())
    return bool(one == other)


@pytest.mark.parametrize(
    "wrong",
    [
        {"start": np.array([0.0, np.nan])},
        {"start": np.array([0.0, 1e300])},
        {"start": np.zeros(3)},
        {"tool": ToolOrder("right:7", "turn", 1.0)},
        {"tool": ToolOrder("", "close", 1.0)},
        {"tool": ToolOrder("right:7", "close", -1.0)},
        {"tool": ToolOrder("right:7", "close", np.nan)},
    ],
)
def test_numbers_that_no_robot_has_are_refused(wrong: dict[str, Any]) -> None:
    link = Link("run", "left", START)
    link.clear(some_nodes(random.Random(1), 2))
    command = link.command(0.0)
    assert isinstance(command, Command)
    with pytest.raises(MessageError):
        read_command(command_bytes(replace(command, **wrong)))


def test_a_driver_asks_until_its_cell_is_there_and_again_when_it_was_cut_off() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, over = f"127.0.0.1:{port}", [False]
    end = DriverEnd(SimulatedArm(), "left", 1)
    thread = threading.Thread(
        target=drive_remotely, args=(end, address), kwargs={"over": lambda: over[0]}
    )
    thread.start()
    for number in (1, 2):
        service, heard = Service(address), list[Report]()
        wire = service.wire("left", 2)
        wire.open(heard.append)
        link = Link("run", "left", START)
        link.restore(number, 0)
        link.clear(some_nodes(random.Random(3), 3))
        while link.done < number:
            if (command := link.command(time.monotonic())) is not None:
                wire.send(command)
            while heard:
                link.receive(heard.pop(0), time.monotonic())
            time.sleep(0.02)
        assert link.done >= number
        wire.close()
    over[0] = True
    thread.join()


def test_a_driver_that_is_refused_says_why(service: Service) -> None:
    service.wire("right", 6)
    end = DriverEnd(SimulatedArm(), "left", 1)
    with pytest.raises(
        TwinError, match="no robot 'left' waits for a driver here: right"
    ):
        drive_remotely(end, f"127.0.0.1:{service.port}")


def test_what_is_served_is_what_the_proto_file_says(tmp_path: Path) -> None:
    protoc = pytest.importorskip("grpc_tools.protoc")
    folder, made = DESCRIPTION.parent, tmp_path / "cell.binpb"
    words = ["protoc", f"-I{folder}", f"--descriptor_set_out={made}", "cell.proto"]
    assert protoc.main(words) == 0
    assert made.read_bytes() == DESCRIPTION.read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("listen: 0.0.0.0:50551", "is not on this machine"),
        ("certificates: nowhere", "is missing"),
    ],
)
def test_what_cannot_be_served_is_refused_before_anything_is_planned(
    tmp_path: Path, text: str, words: str
) -> None:
    file, out = tmp_path / "drivers.yaml", tmp_path / "run"
    file.write_text(f"{text}\nrobots: {{left: {{kind: grpc}}}}\n")
    with pytest.raises(RequestError, match=words):
        twin.operate("cliff", drivers=file, out=out)
    assert not out.exists()


def wait_for(met: Callable[[], bool], seconds: float = 20.0) -> bool:
    deadline = time.monotonic() + seconds
    while not met() and time.monotonic() < deadline:
        time.sleep(0.02)
    return met()


def test_silent_streams_take_nobody_the_room(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_service, "_SILENT_S", 1.0)
    wire, heard, over = service.wire("left", 6), list[Report](), threading.Event()
    wire._deliver = heard.append
    end = DriverEnd(SimulatedArm(stands=np.zeros(6)), "left", 1)

    def nothing() -> Iterator[bytes]:
        over.wait()
        yield b""

    def reports(robots: Sequence[str] = ("left",) * 20) -> Iterator[bytes]:
        for robot in robots:
            yield report_bytes(replace(end.report(), robot=robot))
            time.sleep(0.02)

    with channel_to(f"127.0.0.1:{service.port}", None) as channel:
        ask = channel.stream_stream(METHOD)
        silent = [ask(nothing()) for _ in range(60)]
        assert list(ask(reports(), timeout=20.0)) == []
        assert len(heard) == 19
        assert wait_for(lambda: all(call.done() for call in silent))
        assert wait_for(lambda: not service._streams)
        # One that has been let in and says nothing more is closed as well.
        first = report_bytes(end.report())
        mute = ask(itertools.chain([first], nothing()))
        assert wait_for(mute.done)
        # A stream is of one robot, and that of who asks last.
        with pytest.raises(grpc.RpcError) as error:
            list(ask(reports(["left", "left", "right"]), timeout=20.0))
        assert error.value.code() == grpc.StatusCode.INVALID_ARGUMENT
        before = ask(itertools.chain([first], nothing()))
        assert wait_for(lambda: bool(service._streams))
        assert list(ask(reports(), timeout=20.0)) == []
        assert before.done()
        over.set()


def test_a_message_that_is_too_long_ends_its_stream(service: Service) -> None:
    service.wire("left", 6)
    with channel_to(f"127.0.0.1:{service.port}", None) as channel:
        message = channel.stream_stream(METHOD)(iter([bytes(MOST_BYTES + 1)]))
        with pytest.raises(grpc.RpcError) as error:
            list(message)
    assert error.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["joints NaN", "all 2^32", "off -1"])
def test_a_false_report_ends_a_run(
    plan: PlanResult, service: Service, name: str
) -> None:
    address, chain = f"127.0.0.1:{service.port}", plan.tpg.chains[0]
    honest, over = [len(chain)], [False]

    class Lying(DriverEnd):
        def report(self) -> Report:
            report = super().report()
            if report.state.done <= 5 or report.robot != chain.robot:
                return report
            honest[0] = min(honest[0], report.state.done)
            return FALSE[name][1](report, chain)

    def drive(robot: str) -> None:
        end = Lying(SimulatedArm(pace=PACE), robot, 1)
        drive_remotely(end, address, over=lambda: over[0])

    threads = [
        threading.Thread(target=drive, args=(own.robot,)) for own in plan.tpg.chains
    ]
    for thread in threads:
        thread.start()
    done = operated(plan, service)
    over[0] = True
    for thread in threads:
        thread.join(20.0)
    assert done.record.outcome == "failed"
    completed = sum(end >= 0 for end in done.record.end_ns[0].tolist())
    assert completed <= honest[0] < len(chain)
    require_order(done)


@pytest.mark.nightly
def test_a_driver_that_waits_for_its_cell_asks_for_it_about_once_a_second() -> None:
    """By default gRPC asks ever more seldom, so that a cell would give up a driver that waits for it."""
    asked, over = 0, [False]
    end = DriverEnd(SimulatedArm(), "left", 1)
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        nobody.settimeout(0.2)
        address = f"127.0.0.1:{nobody.getsockname()[1]}"
        options = {"over": lambda: over[0]}
        thread = threading.Thread(
            target=drive_remotely, args=(end, address), kwargs=options
        )
        thread.start()
        until = time.monotonic() + 30.0
        while time.monotonic() < until:
            try:
                nobody.accept()[0].close()
                asked += 1
            except TimeoutError:
                pass
        over[0] = True
        thread.join()
    assert asked > 12
