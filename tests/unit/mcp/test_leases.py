"""What a client over HTTP moves ends when it goes: once, and nobody else's. The leases are real, the bridge is not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import replace
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest
from anyio.lowlevel import checkpoint, checkpoint_if_cancelled

from ros2_mcp.guard.entrance import entrance_of
from ros2_mcp.mcp import leases as subject
from ros2_mcp.mcp.leases import CLIENT_LEASE_S, RESPONSE, Leases, principal_of
from ros2_mcp.model.commands import LOCAL, Principal, Publish, Repeat
from ros2_mcp.model.errors import Stopped
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from support.noting_bridge import CHOICE, GOAL_ID, TWIST, Noting, call, goal, on
from support.rounds import FULL
from support.tasks import soon

pytestmark = pytest.mark.anyio
AT_REST_S = 3.0
"""Sixty looks at the leases."""


class Response:
    """To a request of a client that sends and acknowledges nothing any more, once `heard` is past."""

    def __init__(self, *, listens: bool = False) -> None:
        self.listens, self.is_open, self.was_closed = listens, True, False
        self.heard = 1.0

    def heard_at(self) -> float:
        return self.heard

    async def show_alive(self) -> None: ...

    def close(self, leases: Leases) -> None:
        self.is_open, self.was_closed = False, True
        leases.closed(self)


@pytest.fixture
async def leases(robot: Robot) -> AsyncGenerator[Leases, None]:
    leases = Leases(robot)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(leases.keep)
        await checkpoint()
        yield leases
        tasks.cancel_scope.cancel()


def request(response: Response | None = None, program: str = "a") -> Any:
    """The context of a request of the modern era."""
    scope: dict[str, Any] = {"headers": {}, "path": "/mcp", RESPONSE: response}
    client_params = SimpleNamespace(client_info=SimpleNamespace(name=program, version="1"))
    asked = SimpleNamespace(scope=scope, headers={}, client=SimpleNamespace(host="10.0.0.1"))
    session = SimpleNamespace(client_params=client_params, can_send_request=False)
    return SimpleNamespace(request=asked, session=session, method="tools/call", request_id=1)


CLIENT, OTHER = principal_of(request()), principal_of(request(program="b"))


def publish(principal: Principal, topic: str = "/cmd_vel") -> Publish:
    return replace(Publish(**on(topic, value={}, choice=CHOICE, wait_match_s=0.0)), principal=principal)


def repeat(principal: Principal, topic: str = "/cmd_vel") -> Repeat:
    return replace(Repeat(**on(topic, value={}, choice=CHOICE, wait_match_s=0.0)), principal=principal)


async def test_a_departure_is_ended_once_also_where_nobody_acknowledges_or_sees_the_goal_end(
    robot: Robot, bridge: Noting, leases: Leases
) -> None:
    bridge.zeros = [{"topic": "/cmd_vel", "type": TWIST, "matched": 1, "acked": None}]
    session = robot.session(CLIENT)
    await robot.do(publish(CLIENT), session)
    await robot.values.learn("made/action/Go", "action_msgs/srv/CancelGoal")
    accepted = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": True})
    cancelling = robot.values.encode_known("action_msgs/srv/CancelGoal_Response", {"return_code": 0})
    bridge.answer = accepted
    await robot.do(replace(goal(), principal=CLIENT), session)
    bridge.answer = cancelling
    leases.asked(CLIENT)
    await soon(lambda: "zero" in bridge.sent)
    await asyncio.sleep(AT_REST_S)
    assert (bridge.sent.count("zero"), bridge.sent.count("call")) == (1, 2)
    leases.asked(CLIENT)  # it comes again, and goes again: its goal may still run
    await soon(lambda: bridge.sent.count("call") == 3)
    assert bridge.sent.count("zero") == 1


@pytest.mark.parametrize("code", [2, 3])
async def test_a_goal_that_its_server_says_it_does_not_run_any_more_is_no_motion(
    robot: Robot, bridge: Noting, code: int
) -> None:
    await robot.values.learn("made/action/Go", "action_msgs/srv/CancelGoal")
    bridge.answer = robot.values.encode_known("made/action/Go_SendGoal_Response", {"accepted": True})
    await robot.do(replace(goal(), principal=CLIENT))
    assert robot.moves_for(CLIENT)
    bridge.answer = robot.values.encode_known("action_msgs/srv/CancelGoal_Response", {"return_code": code})
    assert await robot.stop_owned(CLIENT) == [f"goal {GOAL_ID}"]
    assert not robot.moves_for(CLIENT)


async def test_a_look_between_the_end_of_a_connection_and_the_close_it_brings_names_the_end_of_the_client(
    robot: Robot, bridge: Noting, leases: Leases, caplog: pytest.LogCaptureFixture
) -> None:
    response = Response(listens=True)
    response.heard = monotonic() + 60
    leases.asked(CLIENT, response)
    await robot.do(publish(CLIENT))
    await soon(lambda: leases._clients[CLIENT].is_moving)
    with caplog.at_level("INFO"):
        leases._clients[CLIENT].asked_at = leases._clients[CLIENT].granted_at = response.heard = 0.0
        await soon(lambda: "ended by" in caplog.text)
    assert "the end of its client" in caplog.text and subject._UNHEARD not in caplog.text


async def test_the_end_of_one_client_leaves_what_another_moves_on_the_same_topic(robot: Robot, bridge: Noting) -> None:
    gone, stays = robot.session(CLIENT), robot.session(OTHER)
    await robot.values.learn(TWIST)
    bridge.may_answer.clear()
    repeating = asyncio.ensure_future(robot.do(repeat(OTHER), stays))
    await soon(lambda: "repeat" in bridge.sent)
    once = asyncio.ensure_future(robot.do(publish(CLIENT), gone))
    await soon(lambda: "publish" in bridge.sent)
    assert robot.moves_for(CLIENT) and robot.moves_for(OTHER)
    await robot.stop_owned(CLIENT)
    with pytest.raises(Stopped):
        await once
    assert "zero" not in bridge.sent and not repeating.done()
    assert not robot.moves_for(CLIENT) and robot.moves_for(OTHER)
    bridge.may_answer.set()
    await repeating
    # It has ended with its zero, but the other message may have left after that: nobody here can tell.
    assert robot.moves_for(OTHER)
    await robot.stop_owned(OTHER)
    assert not robot.moves_for(OTHER)


async def test_a_topic_that_both_have_commanded_is_the_last_ones(robot: Robot, bridge: Noting) -> None:
    await robot.do(publish(CLIENT))
    await robot.do(publish(OTHER))
    await robot.stop_owned(CLIENT)
    assert "zero" not in bridge.sent and robot.moves_for(OTHER)
    await robot.stop_owned(OTHER)
    assert bridge.arguments["zero"]["topics"] == ["/cmd_vel"] and not robot.moves_for(OTHER)


@pytest.mark.parametrize("acts", [True, False])
async def test_a_call_whose_response_was_closed_before_its_handler_began_does_nothing(
    robot: Robot, bridge: Noting, leases: Leases, acts: bool
) -> None:
    await robot.do(publish(CLIENT))
    response = Response()
    response.close(leases)
    has_run = False
    with leases.attended(request(response), acts=acts) as attended:
        await checkpoint_if_cancelled()
        has_run = True
    assert not has_run and "closed the response" in attended.end_reason
    if acts:
        await soon(lambda: "zero" in bridge.sent)
    else:
        await asyncio.sleep(0.2)
        assert "zero" not in bridge.sent


async def test_calls_about_one_robot_leave_room_for_those_about_another(leases: Leases) -> None:
    def under_way() -> list[int]:
        return [leases.calls_under_way(about) for about in ("lab", "yard", "")]

    with leases.attended(request(Response()), acts=False, about="lab"):
        with leases.attended(request(Response()), acts=True, about="lab"), leases.attended(request(), acts=True):
            assert under_way() == [2, 0, 1]
        assert under_way() == [1, 0, 0]


async def test_a_request_whose_response_was_closed_is_no_sign_of_life(robot: Robot, leases: Leases) -> None:
    response = Response()
    response.close(leases)
    leases.asked(CLIENT, cast(Any, response))
    assert CLIENT not in leases._clients  # pyright: ignore[reportPrivateUsage]


async def test_a_call_that_waits_is_ended_when_its_client_has_vanished(
    robot: Robot, bridge: Noting, leases: Leases
) -> None:
    """A call of a service that is not there yet: nothing moves so far."""
    await robot.values.learn("std_srvs/srv/SetBool")
    bridge.may_answer.clear()
    response, ended = Response(), asyncio.Event()
    session = robot.session(CLIENT)

    async def calling() -> None:
        leases.asked(CLIENT, cast(Any, response))
        with leases.attended(request(response), acts=True) as attended:
            await robot.do(call("std_srvs/srv/SetBool", "/switch", {"data": True}), session)
        assert "client lease" in attended.end_reason
        ended.set()

    waiting = asyncio.ensure_future(calling())
    began = monotonic()
    await soon(ended.is_set)
    took_s = monotonic() - began
    assert took_s > CLIENT_LEASE_S - 0.1
    if FULL:
        assert took_s < CLIENT_LEASE_S + 1.0
    await waiting


async def test_closing_a_read_stops_nothing_of_another_client_of_the_same_name(
    robot: Robot, bridge: Noting, leases: Leases
) -> None:
    await robot.do(publish(CLIENT))

    def closed(*, listens: bool, acts: bool) -> None:
        response = Response(listens=listens)
        leases.asked(CLIENT, cast(Any, response))
        with leases.attended(request(response), acts=acts):
            response.close(leases)

    closed(listens=False, acts=False)
    await asyncio.sleep(0.2)
    assert "zero" not in bridge.sent
    closed(listens=True, acts=False)
    await soon(lambda: "zero" in bridge.sent)


async def test_the_servers_own_lateness_is_made_good_for_once_in_a_silence() -> None:
    now = monotonic()
    client = subject.Client(CLIENT, asked_at=now)
    for stall in range(1, 20):
        client.credit(0.6, now + 0.6 * stall)
    assert client.lease_ends_at() == pytest.approx(now + 2 * CLIENT_LEASE_S)
    client.asked_at = later = now + 100.0  # a new silence
    client.credit(0.6, later + 0.6)
    assert client.lease_ends_at() == pytest.approx(later + CLIENT_LEASE_S + 0.6)
    client.asked_at = later = now + 200.0
    client.credit(10.0, later + 10.5)  # what it had left when the server began to stand still
    assert client.lease_ends_at() == pytest.approx(later + 10.0 + CLIENT_LEASE_S)


async def test_a_departure_while_another_is_carried_out_is_carried_out_afterwards(
    robot: Robot, bridge: Noting, leases: Leases
) -> None:
    await robot.do(publish(CLIENT))
    leases.asked(CLIENT)
    bridge.may_answer.clear()
    leases.left(CLIENT)
    await soon(lambda: bridge.sent.count("zero") == 1)
    leases.asked(CLIENT)
    moving = asyncio.ensure_future(robot.do(publish(CLIENT)))
    await soon(lambda: bridge.sent.count("publish") == 2)
    leases.left(CLIENT)
    bridge.may_answer.set()
    await soon(lambda: bridge.sent.count("zero") == 2)
    await asyncio.wait({moving})


async def test_a_fault_does_not_end_the_watch(
    robot: Robot, bridge: Noting, leases: Leases, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(*_: object) -> None:
        raise KeyError("a fault")

    await robot.do(publish(CLIENT))
    await robot.do(publish(OTHER, "/other"))
    with monkeypatch.context() as broken:
        broken.setattr(robot, "stop_owned", fails)
        leases.asked(CLIENT)
        leases.left(CLIENT)
        await asyncio.sleep(0.1)
    broken_response = Response()
    broken_response.heard_at = lambda: 1 / 0
    leases.asked(CLIENT, cast(Any, broken_response))
    await robot.do(publish(CLIENT))
    leases.asked(OTHER)
    await soon(lambda: "zero" in bridge.sent)
    assert bridge.arguments["zero"]["topics"] == ["/other"]


async def test_the_clients_whose_ends_are_remembered_are_bounded(robot: Robot) -> None:
    accepted = robot.stops.now()
    for number in range(5000):
        robot.stops.end_of(Principal(name=f"http_{number}", transport="http"))
    assert len(robot.stops._ended_at) <= 1000  # pyright: ignore[reportPrivateUsage]
    robot.stops.check(LOCAL, accepted)
    with pytest.raises(Stopped):
        robot.stops.check(Principal(name="http_4999", transport="http"), accepted)


@pytest.mark.parametrize(
    ("host", "port", "accepted"),
    [
        ("fe80::1", 8000, "[fe80::1]:8000"),
        ("[fe80::1]", 8000, "[fe80::1]:8000"),
        ("Robot.local", 8000, "robot.local:8000"),
        ("robot", 80, "robot"),
        ("robot", 80, "robot:80"),
        ("0.0.0.0", 80, "localhost"),
    ],
)
async def test_the_address_that_is_listened_on_is_accepted_as_clients_write_it(
    host: str, port: int, accepted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(transport="streamable-http", host=host, port=port, behind_proxy=True)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    entrance = entrance_of(settings)
    assert accepted in entrance.hosts and f"http://{accepted}" in entrance.origins
