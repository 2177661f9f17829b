"""Writer of MCAP log files with ROS 2 messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO

from planning.errors import OutputError
from twin.exports.ros.definitions import DEFINITIONS
from twin.host.extras import extra_module

_CHUNK = 4 << 20
"""Number of bytes that are compressed together; larger chunks compress repeated frames better."""

_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_TRANSIENT_LOCAL, _VOLATILE = 1, 2

# As rosbag2 wrote it until Humble, in numbers. Later ones read it where a file says of itself
# nothing newer, which an empty text does.
_ROSBAG2 = {"serialized_metadata": "", "ROS_DISTRO": "humble"}


@dataclass(frozen=True)
class Topic:
    """A ROS topic.

    Attributes:
        name: its name.
        type: of its messages, one of DEFINITIONS.
        latched: whether late subscribers get the last message.
    """

    name: str
    type: str
    latched: bool = False


@dataclass(frozen=True, eq=False)
class Message:
    """A message.

    Attributes:
        t_ns: when [ns].
        topic: where.
        data: encoded.
    """

    t_ns: int
    topic: Topic
    data: bytes


def rosbag_file(messages: Iterable[Message]) -> bytes:
    """Return an MCAP file of messages, by their time; those of one time keep their order.

    Raises:
        OutputError: the package that writes such files is not installed.
    """
    writers = extra_module(
        "mcap.writer",
        package="mcap",
        extra="mcap",
        needs="the format mcap",
        error=OutputError,
    )
    buffer = BytesIO()
    writer = writers.Writer(buffer, chunk_size=_CHUNK)
    writer.start(profile="ros2", library="assembly-twin")
    writer.add_metadata("rosbag2", _ROSBAG2)
    schemas: dict[str, int] = {}
    channels: dict[Topic, int] = {}
    counts: dict[Topic, int] = {}
    for message in sorted(messages, key=lambda message: message.t_ns):
        topic = message.topic
        if topic.type not in schemas:
            text = DEFINITIONS[topic.type].encode()
            schemas[topic.type] = writer.register_schema(topic.type, "ros2msg", text)
        if topic not in channels:
            channels[topic] = writer.register_channel(
                topic.name,
                "cdr",
                schemas[topic.type],
                {"offered_qos_profiles": _qos(topic)},
            )
        counts[topic] = counts.get(topic, -1) + 1
        writer.add_message(
            channels[topic],
            log_time=message.t_ns,
            publish_time=message.t_ns,
            sequence=counts[topic],
            data=message.data,
        )
    writer.finish()
    return buffer.getvalue()


def _qos(topic: Topic) -> str:
    """Return the qualities of service that a topic is offered with, as YAML."""
    durability = _TRANSIENT_LOCAL if topic.latched else _VOLATILE
    return (
        f"- history: 1\n  depth: {1 if topic.latched else 100}\n  reliability: 1\n"
        f"  durability: {durability}\n  deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n"
        f"  liveliness: 1\n  liveliness_lease_duration: {_FOREVER}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
