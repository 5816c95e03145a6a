"""The QoS of a topic's publishers as rosbag2 stores it: YAML, with the numbers or the words of `rmw`.

A module of its own, imported only where such a text is read or written: `rosbags.rosbag2` takes 55 ms to import, which
would slow down opening a bag.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeVar

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import ReaderError, metadata

from ros2_mcp.model.qos import QoS

_INFINITE = QosTime(9223372036, 854775807)  # 2^63 - 1 ns, as rmw writes it
_INFINITE_FROM_S = 2147483647  # Fast DDS of earlier distributions wrote 2^31 - 1 s for infinite
_Policy = TypeVar("_Policy", QosHistory, QosReliability, QosDurability, QosLiveliness)


def qos_text(publishers: Sequence[QoS]) -> str:
    """Return the publishers' QoS in rosbag2's format, with numbers instead of names: every distribution since Foxy
    reads numbers.
    """
    return metadata.dump_qos_v8([_to_rosbags(qos) for qos in publishers])


@lru_cache(maxsize=256)  # parsing takes 2 ms, and the topics of a robot have few different texts
def parse_qos(text: str) -> tuple[QoS, ...]:
    """Parse rosbag2's text into the QoS of each publisher of the topic; empty if the text is empty or damaged."""
    try:
        return tuple(_from_rosbags(qos) for qos in metadata.parse_qos(text))
    except (ReaderError, ValueError, TypeError, KeyError, AttributeError):  # what rosbags raises for other YAML
        return ()


def is_latched(text: str) -> bool:
    """Return whether a publisher of the topic kept its last messages for late subscribers (transient_local)."""
    return any(qos.durability == "transient_local" for qos in parse_qos(text))


def _to_rosbags(qos: QoS) -> Qos:
    return Qos(
        history=_policy(QosHistory, qos.history),
        depth=qos.depth or 0,
        reliability=_policy(QosReliability, qos.reliability),
        durability=_policy(QosDurability, qos.durability),
        deadline=_time(qos.deadline_ns),
        lifespan=_time(qos.lifespan_ns),
        liveliness=_policy(QosLiveliness, qos.liveliness),
        liveliness_lease_duration=_time(qos.liveliness_lease_ns),
        avoid_ros_namespace_conventions=False,
    )


def _from_rosbags(qos: Qos) -> QoS:
    return QoS(
        reliability=qos.reliability.name.lower(),
        durability=qos.durability.name.lower(),
        history=qos.history.name.lower(),
        depth=qos.depth,
        deadline_ns=_duration_ns(qos.deadline),
        lifespan_ns=_duration_ns(qos.lifespan),
        liveliness=qos.liveliness.name.lower(),
        liveliness_lease_ns=_duration_ns(qos.liveliness_lease_duration),
    )


def _policy(policies: type[_Policy], word: str) -> _Policy:
    return policies.__members__.get(word.upper(), policies["UNKNOWN"])


def _time(duration_ns: int | None) -> QosTime:
    return _INFINITE if duration_ns is None else QosTime(*divmod(duration_ns, 1_000_000_000))


def _duration_ns(time: QosTime) -> int | None:
    """Return a duration in ns; None is infinite, as is zero, which rmw writes for a duration that was not set."""
    if time.sec >= _INFINITE_FROM_S or time == (0, 0):
        return None
    return time.sec * 1_000_000_000 + time.nsec
