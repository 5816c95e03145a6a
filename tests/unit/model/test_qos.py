from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from ros2_mcp.model.qos import Endpoint, QoS, for_publishing, for_subscribing, mismatch

RELIABLE, BEST_EFFORT = "reliable", "best_effort"
LATCHED, VOLATILE = "transient_local", "volatile"


def endpoints(*policies: tuple[str, str]) -> list[Endpoint]:
    return [
        Endpoint(f"/node{number}", "std_msgs/msg/String", "", str(number), QoS(reliability, durability))
        for number, (reliability, durability) in enumerate(policies)
    ]


@pytest.mark.parametrize(
    ("offered", "chosen"),
    [
        ([], (BEST_EFFORT, VOLATILE)),
        ([(RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
        ([(RELIABLE, LATCHED)], (RELIABLE, LATCHED)),
        ([(BEST_EFFORT, VOLATILE)], (BEST_EFFORT, VOLATILE)),
        ([(RELIABLE, LATCHED), (RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
        ([(RELIABLE, LATCHED), (BEST_EFFORT, LATCHED)], (BEST_EFFORT, LATCHED)),
        ([("unknown", "unknown")], (BEST_EFFORT, VOLATILE)),
    ],
)
def test_a_subscription_asks_for_what_every_publisher_offers(
    offered: list[tuple[str, str]], chosen: tuple[str, str]
) -> None:
    qos = for_subscribing(endpoints(*offered)).qos
    assert (qos.reliability, qos.durability) == chosen


@pytest.mark.parametrize(
    ("asked", "chosen"),
    [
        ([], (RELIABLE, VOLATILE)),
        ([(RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
        ([(BEST_EFFORT, VOLATILE)], (BEST_EFFORT, VOLATILE)),
        ([(BEST_EFFORT, VOLATILE), (RELIABLE, VOLATILE)], (RELIABLE, VOLATILE)),
        ([(BEST_EFFORT, VOLATILE), (RELIABLE, LATCHED)], (RELIABLE, LATCHED)),
        ([("unknown", "unknown")], (RELIABLE, VOLATILE)),
    ],
)
def test_a_publisher_offers_what_every_subscriber_asks_for(
    asked: list[tuple[str, str]], chosen: tuple[str, str]
) -> None:
    qos = for_publishing(endpoints(*asked)).qos
    assert (qos.reliability, qos.durability) == chosen


KINDS = list(product((RELIABLE, BEST_EFFORT), (LATCHED, VOLATILE)))


@pytest.mark.parametrize("others", list(product(KINDS, repeat=2)))
def test_the_chosen_qos_matches_everybody(others: tuple[tuple[str, str], ...]) -> None:
    there = endpoints(*others)
    assert [mismatch(publisher.qos, for_subscribing(there).qos) for publisher in there] == ["", ""]
    asking_for_nothing_impossible = [other for other in there if other.qos.reliability == RELIABLE]
    offered = for_publishing(there).qos
    assert [mismatch(offered, subscriber.qos) for subscriber in asking_for_nothing_impossible] == [""] * len(
        asking_for_nothing_impossible
    )


def test_the_reason_counts_who_offers_what() -> None:
    reason = for_subscribing(endpoints((RELIABLE, VOLATILE), (BEST_EFFORT, VOLATILE), (RELIABLE, VOLATILE))).reason
    assert reason == "3 publishers: 2 reliable, 0 transient_local"


@pytest.mark.parametrize(
    ("publisher", "subscriber", "reason"),
    [
        (QoS(RELIABLE), QoS(BEST_EFFORT), ""),
        (QoS(durability=LATCHED), QoS(durability=VOLATILE), ""),
        (QoS(BEST_EFFORT), QoS(RELIABLE), "the publisher offers best_effort, the subscriber asks for reliable"),
        (
            QoS(durability=VOLATILE),
            QoS(durability=LATCHED),
            "the publisher offers volatile, the subscriber asks for transient_local",
        ),
        (
            QoS(),
            QoS(deadline_ns=500_000_000),
            "the publisher's deadline (infinite) is longer than the subscriber asks for (0.5 s)",
        ),
        (
            QoS(deadline_ns=6_000_000_000),
            QoS(deadline_ns=5_000_000_000),
            "the publisher's deadline (6 s) is longer than the subscriber asks for (5 s)",
        ),
        (QoS(deadline_ns=5), QoS(deadline_ns=5), ""),
        (QoS(deadline_ns=5), QoS(), ""),
        (
            QoS(),
            QoS(liveliness="manual_by_topic"),
            "the publisher offers automatic liveliness, the subscriber asks for manual_by_topic",
        ),
        (
            QoS(liveliness_lease_ns=None),
            QoS(liveliness_lease_ns=2_500_000_000),
            "the publisher's liveliness lease (infinite) is longer than the subscriber asks for (2.5 s)",
        ),
        (QoS("unknown", "unknown"), QoS(RELIABLE, LATCHED), ""),
    ],
)
def test_a_pair_that_never_exchanges_a_message_is_told_in_words(publisher: QoS, subscriber: QoS, reason: str) -> None:
    assert mismatch(publisher, subscriber) == reason


def test_all_reasons_of_a_mismatch_are_told() -> None:
    assert mismatch(QoS(BEST_EFFORT), QoS(RELIABLE, LATCHED)).count(";") == 1


def test_an_endpoint_is_read_from_what_the_bridge_says() -> None:
    qos = {
        "reliability": "reliable",
        "durability": "volatile",
        "history": "unknown",
        "depth": 0,
        "deadline_ns": None,
        "lifespan_ns": None,
        "liveliness": "automatic",
        "liveliness_lease_ns": None,
    }
    raw: Any = {"node": "driver", "namespace": "/arm", "type": "a/msg/B", "hash": "", "gid": "00", "qos": qos}
    assert Endpoint.parse(raw) == Endpoint("/arm/driver", "a/msg/B", "", "00", QoS(history="unknown", depth=0))
