"""Serialization of messages between dispatcher and driver as protocol buffers, defined in ``cell.proto``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from planning.errors import TwinError
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, Sample, ToolOrder
from twin.host.extras import extra_module
from twin.live.messages import Command, Report

DESCRIPTION = Path(__file__).with_name("cell.binpb")
"""``cell.proto`` as ``protoc --descriptor_set_out`` writes it."""

LARGEST_NUMBER = 1e12
"""Greatest absolute value of a number in a message."""

MOST_BYTES = 4 << 20
"""Greatest size of a message [B]."""

MOST_SAMPLES = 20_000
"""Greatest number of samples in a report."""

_MOST_TEXT = 1000
"""Number of characters to which texts of a report are cut."""

_ACTS = ("", "close", "open")


class MessageError(TwinError):
    """Bytes that are no valid message."""


@cache
def message_class(name: str) -> Any:
    """Return the class of a message of ``cell.proto``.

    Raises:
        RequestError: protobuf is not installed.
    """
    extra_module(
        "google.protobuf",
        package="protobuf",
        extra="service",
        needs="a driver in another process",
    )
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(DESCRIPTION.read_bytes())
    for file in files.file:
        pool.Add(file)
    found = pool.FindMessageTypeByName(f"assembly_twin.{name}")
    return message_factory.GetMessageClass(found)


def command_bytes(command: Command) -> bytes:
    """Return a command as bytes."""
    kind = message_class("Command")
    nodes = [
        {
            "node": node.node,
            "task": node.task,
            "kind": node.kind,
            "label": node.label,
            "waypoints": np.ravel(node.waypoints).tolist(),
            "seconds": node.seconds.tolist(),
            "act": node.act,
            "object": node.object,
        }
        for node in command.nodes
    ]
    plain = vars(command) | {"start": command.start.tolist(), "nodes": nodes}
    plain["tool"] = None if command.tool is None else vars(command.tool)
    return cast(bytes, kind(**plain).SerializeToString())


def read_command(content: bytes) -> Command:
    """Parse a command.

    Raises:
        MessageError: the bytes are no command.
    """
    message = _parsed("Command", content)
    start = _numbers("start", message.start)
    return Command(
        message.session,
        message.robot,
        message.instance,
        message.number,
        start,
        message.done,
        message.version,
        tuple(_node(item, len(start)) for item in message.nodes),
        message.heard,
        message.held,
        message.leave,
        _order(message.tool) if message.HasField("tool") else None,
    )


def _order(message: Any) -> ToolOrder:
    (seconds,) = _numbers("seconds", [message.seconds])
    if message.act not in _ACTS[1:]:
        raise MessageError(f"tool: unknown act {message.act!r}", choices=_ACTS[1:])
    if not message.name or seconds < 0.0:
        raise MessageError("tool: an order has a name and takes time")
    return ToolOrder(message.name, message.act, float(seconds), message.object)


def _node(message: Any, joints: int) -> ClearedNode:
    waypoints = _numbers("waypoints", message.waypoints)
    seconds = _numbers("seconds", message.seconds)
    if not len(seconds) or len(waypoints) != joints * len(seconds):
        raise MessageError(f"node {message.node}: its waypoints are not one for a time")
    if np.any(np.diff(seconds, prepend=0.0) < 0.0):
        raise MessageError(f"node {message.node}: its times fall")
    if message.act not in _ACTS:
        raise MessageError(
            f"node {message.node}: unknown act {message.act!r}", choices=_ACTS
        )
    return ClearedNode(
        message.node,
        message.task,
        message.kind,
        message.label,
        waypoints.reshape(len(seconds), joints),
        seconds,
        message.act,
        message.object,
    )


def report_bytes(report: Report) -> bytes:
    """Return a report as bytes."""
    kind, state = message_class("Report"), report.state
    samples = [vars(own) | {"q": own.q.tolist()} for own in state.samples]
    plain: dict[str, Any] = {k: v for k, v in vars(report).items() if k != "state"}
    plain |= vars(state) | {
        "q": state.q.tolist(),
        "dq": state.dq.tolist(),
        "samples": samples,
        "failed": None if state.failed < 0 else state.failed,
    }
    return cast(bytes, kind(**plain).SerializeToString())


def read_report(content: bytes, joints: int = 0) -> Report:
    """Parse a report, without the checks of ``report_fault``.

    Args:
        content: the bytes.
        joints: number of joints of the robot. Lists are cut after one more value, so that a wrong length is still
            noticed; long texts are cut, too.

    Raises:
        MessageError: the bytes are no report.
    """
    if len(content) > MOST_BYTES:
        raise MessageError(f"no report: {len(content)} bytes, {MOST_BYTES} at most")
    message = _parsed("Report", content)
    samples = tuple(
        Sample(own.at_s, _first(own.q, joints), own.begun, own.done)
        for own in message.samples[: MOST_SAMPLES + 1]
    )
    state = DriverState(
        message.begun,
        message.done,
        message.mode[:_MOST_TEXT],
        _first(message.q, joints),
        _first(message.dq, joints),
        message.off,
        message.failed if message.HasField("failed") else -1,
        message.words[:_MOST_TEXT],
        samples,
        message.acted[:_MOST_TEXT],
    )
    return Report(
        message.session[:_MOST_TEXT],
        message.robot[:_MOST_TEXT],
        message.instance,
        message.number,
        message.at_s,
        message.seen,
        message.version,
        message.have,
        state,
        message.first,
        message.kept,
    )


def _first(values: Sequence[float], count: int) -> Array:
    """Return the first numbers up to a count, and the next one, if any."""
    return np.array(values[: count + 1], dtype=float)


def _parsed(name: str, content: bytes) -> Any:
    from google.protobuf.message import DecodeError

    try:
        return message_class(name).FromString(content)
    except (DecodeError, ValueError) as error:
        raise MessageError(f"no {name.lower()}: {error}") from None


def _numbers(name: str, values: Iterable[float]) -> Array:
    found = np.array(values, dtype=float)
    if not np.all(np.isfinite(found)) or np.any(np.abs(found) > LARGEST_NUMBER):
        raise MessageError(f"{name}: no finite numbers")
    return found
