"""However a client over HTTP goes, what it keeps moving stops: judged by an observer in another process.

The clients of these tests are on the far side of a network of two, which can be taken away.
"""

from __future__ import annotations

import itertools
import os
import signal
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import anyio
import pytest

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample
from ros2_mcp_bridge.velocities import UNSURE_AGAIN_S
from support.agent import FULL, until
from support.commanded import CommandedProcess
from support.networks import Network, NotPermitted, network
from support.observer import TWIST, Observer, observing
from support.ports import listening
from support.standstill import undisturbed
from support.structured import META
from support.tokens import client_at

ROUNDS = 200 if FULL else 5
TOGETHER = 5
"""So many clients of each transport vanish, or are stopped, at the same time: a round each."""
TRANSPORTS = ("handshake", "modern", "sse")
MOTIONS = ("repeat", "relay", "goal", "playback", "publish")
CLOSED_S, SILENT_S, STOPPED_S = 0.3, 2.0 + 0.3, 10.0 + 0.3
"""What is promised: after a close, after the last packet, and for a repeat whose client answers nothing any more."""
STILL_S = 0.3
"""How long nothing may move afterwards: several periods of what drove."""
ARRIVES_S = 0.05
"""Between a zero's publishing and the observer's time for it, on a busy machine."""
RECORDED = "/recorded/cmd_vel"
MOVING = {"linear": {"x": 0.5}}
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Field:
    """What the tests of this file share. `ports` are those of the servers, by transport."""

    observer: Observer
    ports: dict[str, int]
    host: str
    network: Network | None
    environment: dict[str, str]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the bag `drive`: ten seconds of a velocity."""
    folder = tmp_path_factory.mktemp("bags")
    (folder / "drive").mkdir()
    writer = BagWriter(folder / "drive", "drive")
    writer.add_topic(StoredTopic(RECORDED, TWIST, None, "ros2msg", ""))
    for number in range(200):
        at_ns = 1_700_000_000_000_000_000 + number * 50_000_000
        writer.write(RECORDED, Sample(at_ns, at_ns, None, b"\0\1\0\0" + struct.pack("<6d", 0.5, 0, 0, 0, 0, 0)))
    writer.close()
    return folder


@pytest.fixture(scope="module")
def field(ros_environment: dict[str, str], bags: Path) -> Iterator[Field]:
    """Two servers, which serve three transports, and the observer."""
    try:
        with network() as two:
            yield from _field(ros_environment, bags, two.host, two)
    except NotPermitted:
        yield from _field(ros_environment, bags, "127.0.0.1", None)


def _field(environment: dict[str, str], bags: Path, host: str, two: Network | None) -> Iterator[Field]:
    with ExitStack() as stack:
        observer = stack.enter_context(observing(environment))
        observer.talk(topic="/talk", kind=TWIST, hz=20)
        ports: dict[str, int] = {}
        options = (
            "--tools",
            "all",
            "--record-dir",
            str(bags),
            "--behind-proxy",
        )  # no TLS, on an address that others reach
        for transport, served in (("streamable-http", ("handshake", "modern")), ("sse", ("sse",))):
            port, _ = stack.enter_context(listening(environment, transport, *options, host=host))
            ports |= dict.fromkeys(served, port)
        yield Field(observer, ports, host, two, environment)


@pytest.fixture
def clients(field: Field) -> Iterator[CommandedProcess]:
    """The process of this test's clients."""
    process = CommandedProcess("http_peer", field.environment, field.network.beside if field.network else ())
    yield process
    process.kill()


@dataclass
class Driver:
    """One client that moves something, and how to see it."""

    field: Field
    clients: CommandedProcess
    transport: str
    motion: str

    def __post_init__(self) -> None:
        self.name = f"driver{next(_numbers)}"
        self.topic, self.action = f"/{self.name}/cmd_vel", f"/{self.name}/count"

    def begin(self, *, keeps_stream: bool = True) -> None:
        """Connects."""
        at = {"host": self.field.host, "port": self.field.ports[self.transport]}
        self.clients.join(name=self.name, transport=self.transport, keeps_stream=keeps_stream, **at)

    def drive(self, *, keeps_stream: bool = True) -> None:
        """Begins, and waits until the observer has seen it move."""
        observer = self.field.observer
        self.begin(keeps_stream=keeps_stream)
        if self.motion == "goal":
            observer.act(action=self.action)
            asked = {"action_name": self.action, "action_type": "test_msgs/action/Fibonacci"}
            goal = {**asked, "goal_fields": {"order": 600}}
            until(lambda: not self.called("ros2_send_action_goal", goal).get("isError"))  # it has yet to be discovered
            until(lambda: any(goal["status"] == "running" for goal in observer.goals_of(action=self.action)))
            return
        for by, best_effort in (("reliable", False), ("best effort", True)):
            observer.join(by=f"{self.name} {by}", topic=self.topic, kind=TWIST, best_effort=best_effort)
        if self.motion == "relay":
            ends = {"source_topic": "/talk", "destination_topic": self.topic, "message_type": TWIST}
            begun = self.called("ros2_relay_start", {**ends, "duration_sec": 0})
            assert not begun.get("isError"), begun
        elif self.motion == "playback":
            played = {"bag": "drive", "remaps": {RECORDED: self.topic}, "force": True, "loop": True, "wait_sec": 0}
            begun = self.called("ros2_bag_play", played)
            assert not begun.get("isError"), begun
        elif self.motion == "publish":
            once = {"topic_name": self.topic, "message_type": TWIST, "data": MOVING}
            until(lambda: self._is_heard_after("ros2_topic_publish", once))  # the first one may miss a new subscriber
        else:
            repeat = {"topic_name": self.topic, "message_type": TWIST, "data": MOVING, "frequency": 20, "duration": 60}
            self.clients.begin(name=self.name, tool="ros2_topic_publish", arguments=repeat)
        observer.until_driven(self.topic, 1 if self.motion == "publish" else 5, 2)

    def rests_after(self, went: int, within_s: float) -> float:
        """Seconds from `went` (monotonic, ns) until the zero, or the end of the goal, after which nothing moves."""
        observer = self.field.observer
        if self.motion == "goal":
            ended = until(lambda: [goal["ended"] for goal in observer.goals_of(action=self.action) if goal["ended"]])
            (goal,) = observer.goals_of(action=self.action)
            assert goal["status"] == "canceled"
            return (ended[0] - went) / 1e9
        assert observer.comes_to_rest(self.topic, within_s + 3.0) == []
        time.sleep(STILL_S)
        zeros: list[int] = []
        for by in ("reliable", "best effort"):
            heard = observer.messages(by=f"{self.name} {by}", topic=self.topic)
            last = max(number for number, one in enumerate(heard) if any(one["values"]))
            assert len(heard) > last + 1, f"{by}: no zero"
            zeros.append(heard[last + 1]["at"])
        for by in ("reliable", "best effort"):
            observer.leave(by=f"{self.name} {by}")
        return (max(zeros) - went) / 1e9

    def heard_by(self, by: str) -> list[dict[str, Any]]:
        """What one subscriber of the observer has received on its topic."""
        return self.field.observer.messages(by=by, topic=self.topic)

    def _is_heard_after(self, tool: str, arguments: dict[str, Any]) -> bool:
        begun = self.called(tool, arguments)
        assert not begun.get("isError"), begun
        return sum(count > 0 for count in self.field.observer.driven(topic=self.topic).values()) == 2

    def called(self, tool: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """The result of a call of a tool."""
        return self.clients.call(name=self.name, tool=tool, arguments=arguments)


def told(what: str, seconds: list[float]) -> None:
    print(f"{what}: {len(seconds)} rounds, zero after at most {max(seconds) * 1000:.0f} ms")


@pytest.mark.promise("README", "within 0.3 s of its closing or resetting its last open response or ending its session")
@pytest.mark.promise("stopping", "a client over HTTP closes or resets its last open response, or ends its session")
@pytest.mark.timeout(3600 if FULL else 240)
@pytest.mark.parametrize(
    ("transport", "way"), [*itertools.product(TRANSPORTS, ("close", "reset")), ("handshake", "DELETE")]
)
def test_a_client_that_closes_leaves_nothing_moving(
    field: Field, clients: CommandedProcess, transport: str, way: str
) -> None:
    def seconds(motion: str) -> float:
        driver = Driver(field, clients, transport, motion)
        driver.drive()
        leave = clients.end_session if way == "DELETE" else partial(clients.go, resetting=way == "reset")
        return driver.rests_after(leave(name=driver.name), CLOSED_S)

    taken: list[float] = []
    for number in range(ROUNDS):
        motion = MOTIONS[number % len(MOTIONS)]
        taken.append(undisturbed(lambda motion=motion: seconds(motion)))
        assert taken[-1] <= CLOSED_S + ARRIVES_S, motion
    told(f"{transport} {way}", taken)


def driving(field: Field, clients: CommandedProcess, motions: Callable[[int], str]) -> list[Driver]:
    """Several clients of every transport that move something."""
    drivers = [
        Driver(field, clients, transport, motions(number)) for transport in TRANSPORTS for number in range(TOGETHER)
    ]
    for driver in drivers:
        driver.drive()
    return drivers


def worst(drivers: list[Driver], went: int, within_s: float) -> dict[str, float]:
    """For each transport the latest rest of all its clients."""
    return {
        transport: max(driver.rests_after(went, within_s) for driver in drivers if driver.transport == transport)
        for transport in TRANSPORTS
    }


@pytest.mark.promise("README", "2.3 s after its last packet where its network is gone")
@pytest.mark.promise("stopping", "the network of a client over HTTP is gone: its client lease (2 s) lapses")
@pytest.mark.timeout(3600 if FULL else 240)
def test_a_client_that_vanishes_with_its_network_leaves_nothing_moving(field: Field, clients: CommandedProcess) -> None:
    """Every packet is lost from then on, nobody is told, and every stream looks open."""
    if field.network is None:
        pytest.skip("this user or machine may not make network namespaces, so that no network can be taken away")
    two = field.network

    def seconds() -> dict[str, float]:
        drivers = driving(field, clients, lambda number: MOTIONS[number % len(MOTIONS)])
        went = time.monotonic_ns()
        two.set_link("down")
        try:
            return worst(drivers, went, SILENT_S)
        finally:
            two.set_link("up")
            for driver in drivers:
                clients.go(name=driver.name, resetting=True)

    taken: dict[str, list[float]] = {transport: [] for transport in TRANSPORTS}
    for _ in range(ROUNDS // TOGETHER):
        for transport, rested_s in undisturbed(seconds).items():
            taken[transport].append(rested_s)
            assert rested_s <= SILENT_S + ARRIVES_S, transport
    for transport, each in taken.items():
        told(f"{transport} silence (x {TOGETHER} clients)", each)


@pytest.mark.promise("README", "A repeat of motion lasts at most 10 s")
@pytest.mark.promise("stopping", "a client over HTTP hangs with its connection open")
@pytest.mark.timeout(3600 if FULL else 240)
def test_a_repeat_of_a_stopped_client_ends_by_itself(field: Field, clients: CommandedProcess) -> None:
    """Its kernel acknowledges for it: it cannot be told from one that waits."""

    def seconds() -> dict[str, float]:
        drivers = driving(field, clients, lambda _: "repeat")
        went = time.monotonic_ns()
        os.kill(clients.pid, signal.SIGSTOP)
        try:
            return worst(drivers, went, STOPPED_S)
        finally:
            os.kill(clients.pid, signal.SIGCONT)
            for driver in drivers:
                clients.go(name=driver.name, resetting=True)

    taken: dict[str, list[float]] = {transport: [] for transport in TRANSPORTS}
    for _ in range(ROUNDS // TOGETHER):
        for transport, rested_s in undisturbed(seconds).items():
            taken[transport].append(rested_s)
            assert rested_s <= STOPPED_S + ARRIVES_S, transport
    for transport, each in taken.items():
        told(f"{transport} stopped (x {TOGETHER} clients)", each)


@pytest.mark.promise("stopping", "by an open response that the client's kernel acknowledges")
@pytest.mark.promise("README", "relays, playbacks and goals of a program that hangs with its connection open go on")
def test_a_client_that_waits_at_an_open_stream_keeps_its_relay(field: Field, clients: CommandedProcess) -> None:
    """The call that began it was answered long ago, and nothing has been asked since."""
    drivers = [Driver(field, clients, transport, "relay") for transport in TRANSPORTS]
    for driver in drivers:
        driver.drive()
    time.sleep(2 * SILENT_S)
    for driver in drivers:
        assert field.observer.moved(sent_after=time.monotonic_ns() - 200_000_000, topic=driver.topic)
        driver.rests_after(clients.go(name=driver.name, resetting=False), CLOSED_S)
        asks = Driver(field, clients, driver.transport, "relay")
        asks.begin()
        relays = asks.called("ros2_relay_list", {})["structuredContent"]["relays"]
        [ended] = [relay for relay in relays if relay["destination_topic"] == driver.topic]
        assert ended["state"] == "stopped" and ended["passed"] > 10 and ended["elapsed_sec"] > SILENT_S
        assert ended["note"].count("end of its client") == 1
        clients.go(name=asks.name, resetting=False)


def test_a_departure_is_ended_once_though_nobody_acknowledges_its_zero(field: Field, clients: CommandedProcess) -> None:
    """The end is not sent again and again over what somebody else, such as an operator, publishes then."""
    driver = Driver(field, clients, "handshake", "publish")
    field.observer.join(by="listener", topic=driver.topic, kind=TWIST, best_effort=True)
    driver.begin()
    once = {"topic_name": driver.topic, "message_type": TWIST, "data": MOVING}
    until(lambda: not driver.called("ros2_topic_publish", once).get("isError") and driver.heard_by("listener"))
    clients.go(name=driver.name, resetting=False)
    until(lambda: not any(driver.heard_by("listener")[-1]["values"]))
    time.sleep(UNSURE_AGAIN_S[-1] + 1.0)  # to who acknowledges nothing the zero is sent again so long
    zeros = len(driver.heard_by("listener"))
    time.sleep(3.0)  # a lease, and a second more
    assert len(driver.heard_by("listener")) == zeros
    field.observer.leave(by="listener")


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_the_departure_of_one_client_leaves_what_another_moves_on_the_same_topic(
    field: Field, clients: CommandedProcess, transport: str
) -> None:
    stays, goes = (Driver(field, clients, transport, "repeat") for _ in range(2))
    stays.drive()
    goes.topic = stays.topic
    goes.begin()
    goes.called("ros2_topic_publish", {"topic_name": goes.topic, "message_type": TWIST, "data": MOVING})
    went = clients.go(name=goes.name, resetting=False)
    time.sleep(1.0)
    heard = [one for one in stays.heard_by(f"{stays.name} reliable") if one["at"] > went]
    assert len(heard) > 10 and all(any(one["values"]) for one in heard)
    stays.rests_after(clients.go(name=stays.name, resetting=False), CLOSED_S)


@pytest.mark.promise(
    "README", "A client that keeps no response open has to ask for something every 2 s while something moves"
)
@pytest.mark.promise("stopping", "A client that keeps no response open has to ask for something every 2 s")
@pytest.mark.promise("stopping", "The client lease holds while something moves")
@pytest.mark.parametrize("transport", ["handshake", "modern"])
def test_a_client_without_an_open_stream_that_asks_for_nothing_keeps_its_relay_for_a_lease(
    field: Field, clients: CommandedProcess, transport: str
) -> None:
    def seconds() -> float:
        driver = Driver(field, clients, transport, "relay")
        driver.drive(keeps_stream=False)
        asked = time.monotonic_ns()
        clients.call(name=driver.name, tool="ros2_relay_list", arguments={})
        return driver.rests_after(asked, SILENT_S)

    rested_s = undisturbed(seconds)
    assert 1.9 < rested_s <= SILENT_S + ARRIVES_S


@pytest.mark.promise("README", "unless its client asks for something or answers a ping meanwhile")
@pytest.mark.promise("stopping", "and by an answered ping")
@pytest.mark.timeout(120)
async def test_a_repeat_outlasts_ten_seconds_where_the_client_answers_pings_and_says_why_where_it_cannot(
    field: Field,
) -> None:
    """Nobody is asked anything in the modern era."""

    async def repeated(mode: str) -> Any:
        url = f"http://{field.host}:{field.ports['handshake']}/mcp"
        repeat = {"message_type": TWIST, "data": MOVING, "frequency": 20, "duration": 12}
        async with client_at(url, mode=mode) as client:
            return await client.call_tool("ros2_topic_publish", {"topic_name": f"/{mode}/cmd_vel", **repeat}, meta=META)

    answers: dict[str, Any] = {}

    async def note(mode: str) -> None:
        answers[mode] = await repeated(mode)

    async with anyio.create_task_group() as both:
        both.start_soon(note, "legacy")
        both.start_soon(note, "auto")
    kept, ended = answers["legacy"].structured_content, answers["auto"].structured_content
    assert kept["sent"] >= 235 and "ended by" not in kept["note"], kept
    assert 160 <= ended["sent"] <= 205 and ended["stopped_with_zero"], ended
    assert "over HTTP a repeat of motion lasts at most 10 s unless" in ended["note"]
