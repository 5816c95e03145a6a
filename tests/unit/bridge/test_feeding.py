"""What a feed that was ended says of what it had handed over."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp_bridge.request import Cancelled, OperationError, Request
from ros2_mcp_bridge.topics.relay import Relay, Relays
from ros2_mcp_common.wire.protocol import EndedBy


class Fed:
    """A relay whose request is ended after so many messages."""

    def __init__(self, most: int, ended_by: EndedBy = "", *, is_running: bool = True) -> None:
        self.most, self.passed, self.ended_by, self.is_running = most, 0, ended_by, is_running

    def publish(self, _data: bytes) -> None:
        if self.passed == self.most:
            raise Cancelled("lease")
        self.passed += 1

    def wait_first_ack(self) -> Generator[float, None, None]:
        yield from ()


def fed(relay: Fed) -> str:
    """What the error of feeding it three messages says."""
    relays = Relays(cast("Any", None), cast("Any", None))
    relays._open["r"] = cast(Relay, relay)
    request = Request({"id": 1, "op": "relay_feed", "name": "r", "sizes": [1, 1, 1]}, b"123")
    with pytest.raises(OperationError) as error:
        list(relays.feed(request))
    return f"{error.value.kind}: {error.value.message}"


def test_a_feed_that_is_stopped_half_way_says_how_much_of_it_was_sent() -> None:
    assert fed(Fed(2)).endswith("its link lease: 2 of 3 messages had been sent.")
    assert fed(Fed(0)).endswith("its link lease: nothing was sent.")


def test_a_feed_that_comes_after_the_end_of_its_relay_says_what_ended_that() -> None:
    assert fed(Fed(3, "stop", is_running=False)).startswith("stopped: A stop came")
    assert fed(Fed(3, "lease", is_running=False)).startswith("lapsed: The server was silent")
    assert fed(Fed(3, "cancel", is_running=False)).startswith("not_found: ")
