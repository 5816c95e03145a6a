"""The link to a robot that is not there: what its bridge would answer to those who play and record."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any, NoReturn

from ros2_mcp.link.client import Bridge, Reply
from ros2_mcp.model.errors import BridgeLost, BridgeRefused, RosNotFound
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept

NUMBER = "std_msgs/msg/Int32"
_QOS: dict[str, Any] = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 1}
_QOS |= {"liveliness": "automatic", "deadline_ns": None, "lifespan_ns": None, "liveliness_lease_ns": None}
_ENDPOINT = {"node": "talker", "namespace": "/", "hash": "", "gid": "", "qos": _QOS}


class MadeBridge(Bridge):
    """Its relays open as soon as it `is_ready`, and end with so many messages `limited`; `heard` has the topics and
    times of what was published.

    `topics` answers who wants to know which there are, `sent` are the types that are published on each of them;
    `has_settled` says whether discovery has.
    """

    def __init__(self) -> None:
        super().__init__(_no_carrier)
        self.is_ready = True
        self.limited = 0
        self._is_lost = False
        self._ended: dict[str, asyncio.Event] = {}
        self.relays: dict[str, str] = {}
        self.heard: list[tuple[str, float]] = []
        self.passed: Counter[str] = Counter()
        self.trouble: Exception | None = None
        self.topics: Callable[[], Any] = list
        self.sent: Sequence[str] = ()
        self.has_settled = True

    async def request(self, op: str, body: bytes = b"", *, timeout_s: float, **arguments: Any) -> Reply:
        del body, timeout_s
        return Reply(await getattr(self, f"_{op}")(**arguments), b"")

    async def subscribe(self, *_: Any, **__: Any) -> NoReturn:
        raise BridgeRefused("bad_request", "This bridge sends no samples.")

    async def _relay(self, name: str, topic: str, **_: Any) -> Any:
        self.relays[name], self._ended[name] = topic, asyncio.Event()
        try:
            await self._ended[name].wait()
        except asyncio.CancelledError:
            self.relays_ended[name] = {"passed": 12, "elapsed_s": 1.5, "ended_by": "cancel", "limited": self.limited}
            raise
        finally:
            del self.relays[name]
        if self._is_lost:
            raise BridgeLost("The bridge was lost.")
        return {"running": False, "passed": 5, "ended_by": "cancel"}

    async def _relay_stop(self, name: str) -> Any:
        self._ended[name].set()
        return {"repeats": 0, "relays": 1}

    def lose_relays(self) -> None:
        """As when the process is killed; the next one knows none of them."""
        self._is_lost = True
        for ended in self._ended.values():
            ended.set()

    async def _relay_feed(self, name: str, sizes: list[int], **_: Any) -> Any:
        if self.trouble:
            raise self.trouble
        if not self.is_ready or name not in self.relays:
            raise BridgeRefused("not_found", "There is no running relay.")
        self.heard += [(self.relays[name], monotonic())] * len(sizes)
        self.passed[name] += len(sizes)
        return {"passed": self.passed[name]}

    async def _relays(self) -> Any:
        return {"relays": {name: {"running": True, "matched": 1} for name in self.relays}}

    async def _endpoints(self, **_: Any) -> Any:
        publishers = [{**_ENDPOINT, "type": sent} for sent in self.sent]
        return {"publishers": publishers, "subscribers": [], "settled": True}

    async def _definitions(self, **_: Any) -> Any:
        return {"missing": [], "definitions": {NUMBER: {"format": "msg", "text": "int32 data\n"}}}

    async def _topics(self, **_: Any) -> Any:
        found = self.topics()
        return {"settled": self.has_settled, "topics": await found if asyncio.iscoroutine(found) else found}


def _no_carrier() -> NoReturn:
    raise RosNotFound("This bridge is made by a test.")


def robot_of(bridge: MadeBridge, *keeps: Kept) -> Robot:
    return Robot(bridge, keeps=keeps)
