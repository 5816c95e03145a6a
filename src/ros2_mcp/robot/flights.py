"""Flights: the jobs that an autopilot carries out, and the orders that begin them.

A mode, arming, a take-off, a landing, a mission or a command through MAVROS makes a vehicle move, and goes on doing so
when its call has been answered. So it is a job; what stops it is a mode in which the vehicle stands, never disarming.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import anyio

from ros2_mcp.model import qos
from ros2_mcp.model.commands import Answer, Principal, ServiceCall
from ros2_mcp.model.errors import RobotError, UnknownInterface
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import services
from ros2_mcp.robot.core import Core
from ros2_mcp.robot.graph import was_refused
from ros2_mcp.robot.jobs import Job
from ros2_mcp.robot.prepared import Prepared
from ros2_mcp_common.policy.flight import BRAKE_MODES, DESCENT_MODES, SET_MODE, only_asks, vehicle_of

STATE_TYPE = "mavros_msgs/msg/State"
BRAKED_S = 3.0
"""MAVROS answers within milliseconds, and tells the new mode with the next heartbeat of the autopilot, each second."""
_CALL_S = 1.0
"""For one mode that is tried: the answer must come soon."""
_EFFECT_S = 2.0
"""After an order was answered its effect may not be in the next state yet: two heartbeats, which come each second."""
_AGAIN_S = 1.0
"""Between attempts to listen to a vehicle whose state nobody publishes yet, and after a lost bridge."""
_CLOSE_S = 0.5
"""A bridge that is alive answers within milliseconds; the end of the server does not wait longer for another."""
_MOST_STATES, _MOST_STATE_BYTES = 50, 100_000
"""Of the state that wait: one comes each second, and with each change."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Braked:
    """What became of the order to stand: the `mode` that the vehicle took ("" where none is known to be sent), whether
    its state said so, and what kept it from it.
    """

    mode: str
    confirmed: bool
    error: str = ""


class Flight(Job):
    """One vehicle that this server has given an order to.

    `vehicle` is the name of its MAVROS, such as `/mavros`; `mode` and `armed` are what it said last ("" and None: not
    heard yet). It is running until the vehicle is heard to be disarmed.
    """

    kind = "flight"
    most_running = 16
    """More vehicles than one MAVROS and one server are used for."""
    ends_elsewhere = True

    def __init__(self, *, owner: Principal, vehicle: str, core: Core) -> None:
        super().__init__(owner=owner, moves=[vehicle])
        self.vehicle = vehicle
        self.mode = ""
        self.armed: bool | None = None
        self._core = core
        self._under_way = 0
        self._ordered_ns = core.now_ns()
        self._news = asyncio.Event()
        self._has_ended = asyncio.Event()

    @property
    def is_running(self) -> bool:
        """Whether it has not been heard to end: at once, and not only when its task has run."""
        return super().is_running and not self._has_ended.is_set()

    @property
    def comes_down(self) -> bool:
        """Whether it is on its way home or down by itself."""
        return self.mode in DESCENT_MODES

    async def run(self) -> None:
        """Listens to the vehicle until it is disarmed. Where it is given up before, its fail-safe stays in force."""
        self.begun()
        async with anyio.create_task_group() as group:
            group.start_soon(self._follow)
            await self._has_ended.wait()
            group.cancel_scope.cancel()

    def ordered(self) -> None:
        """An order is to be sent: it does not end before its effect has been heard of."""
        self._under_way += 1
        self._core.failsafes.leave_brake(self.vehicle)

    def answered(self, was_sent: bool) -> None:
        """That order was answered, or it is known that it was not sent."""
        self._under_way -= 1
        self._ordered_ns = self._core.now_ns()
        if not was_sent and not self._under_way and not self.armed:
            self._end()

    async def stop(self) -> None:
        """Its client has gone: it is told to stand, unless it is on its way down, where it does better to go on.

        It is running until it is heard to be disarmed, as it may move until then.
        """
        if self.is_stopping:  # it has been given up: the bridge's fail-safe makes it stand
            await self.wait()
        elif self.is_running and not self.comes_down:
            braked = await self.brake()
            if braked.error:
                _logger.warning("%s was not made to stand: %s", self.vehicle, braked.error)

    async def brake(self) -> Braked:
        """Tells it to stand, in the best mode that it has, and waits for its state to say so.

        Never raises a `RobotError`. What stops does not pass the policy, and no stop holds it up.
        """
        try:
            mode = await self._order_to_stand()
        except RobotError as error:
            return Braked("", False, str(error))
        if not mode:
            return Braked(
                "", False, f"MAVROS accepted none of the modes {', '.join(BRAKE_MODES)}: the vehicle may still move."
            )
        if await self.until(lambda: self.mode == mode or self.armed is False, BRAKED_S):
            return Braked(mode, True)
        said = f"the vehicle still reports {self.mode}" if self.mode else "the vehicle does not report its mode"
        return Braked(mode, False, f"The mode {mode} was sent, but {said}.")

    async def until(self, holds: Callable[[], bool], within_s: float) -> bool:
        """Waits until something holds of what the vehicle says; whether it does."""
        with anyio.move_on_after(within_s):
            while not holds():
                self._news.clear()
                await self._news.wait()
        return holds()

    async def _order_to_stand(self) -> str:
        """The first mode that MAVROS takes; "" if it takes none."""
        core, service = self._core, f"{self.vehicle}/set_mode"
        await core.values.learn(SET_MODE)
        for mode in BRAKE_MODES:
            body = core.values.encode_known(f"{SET_MODE}_Request", {"base_mode": 0, "custom_mode": mode})
            arguments = {"service": service, "type": SET_MODE, "wait_s": _CALL_S, "within_s": 2 * _CALL_S}
            reply = await core.graph.ask("call", body, timeout_s=_CALL_S, brakes=True, **arguments)
            response: Any = core.values.codec.decode(f"{SET_MODE}_Response", reply.body)
            if response.mode_sent:
                return mode
        return ""

    async def _follow(self) -> None:
        """Listens to the vehicle's state, in one bridge after the other."""
        while True:
            try:
                await self._take_states()
            except RobotError as error:
                _logger.debug("the state of %s cannot be followed: %s", self.vehicle, error)
            await asyncio.sleep(_AGAIN_S)

    async def _take_states(self) -> None:
        core, topic = self._core, f"{self.vehicle}/state"
        await core.values.learn(STATE_TYPE)
        present = await core.graph.endpoints(topic)
        choice = qos.for_subscribing([each for each in present.publishers if each.type == STATE_TYPE])
        if not present.publishers:
            return
        subscription = await core.subscribe(
            topic, STATE_TYPE, choice.qos, max_samples=_MOST_STATES, max_bytes=_MOST_STATE_BYTES
        )
        began_ns = core.now_ns()
        try:
            while True:
                samples = await subscription.take(60.0)
                # MAVROS keeps its last ten states for whoever comes late: of what was before, only the newest counts.
                samples = [sample for sample in samples if _said_ns(sample) >= began_ns] or samples[-1:]
                for sample, state in zip(samples, await core.values.decode_all(STATE_TYPE, samples), strict=True):
                    self._hear(state, _said_ns(sample))
        finally:
            with anyio.move_on_after(_CLOSE_S, shield=True):  # a scope that is cancelled cancels every await again
                await subscription.close()

    def _hear(self, state: Any, said_ns: int) -> None:
        self.mode, self.armed = str(state.mode), bool(state.armed)
        self._news.set()
        if self.comes_down and not self._under_way:  # an order under way may end its descent, and needs the fail-safe
            self._core.failsafes.withdraw_brake(self.vehicle)
        elif self.is_running:
            self._core.failsafes.leave_brake(self.vehicle)
        has_effect = not self._under_way and said_ns > self._ordered_ns + _EFFECT_S * 1e9
        if not self.armed and has_effect:
            self._end()

    def _end(self) -> None:
        self._has_ended.set()
        self._news.set()
        self._core.failsafes.withdraw_brake(self.vehicle)


def _said_ns(sample: Sample) -> int:
    """When it was published, by the robot's clock."""
    return sample.source_ns or sample.received_ns  # some middlewares give no time of sending


async def call(core: Core, prepared: Prepared[ServiceCall]) -> Answer:
    """Carries out a service call; where it is an order to a vehicle, that is a flight before it leaves.

    Raises as `services.call`.
    """
    command = prepared.command
    vehicle = vehicle_of(command.name, command.type)
    if not vehicle or only_asks(command.type, command.value):
        return await services.call(core, prepared)
    await prepared.body()  # an order that does not fit becomes no flight
    core.check_stop(prepared.session)
    try:
        await core.values.learn(SET_MODE)
    except UnknownInterface:  # what stops it is not known here
        return await services.call(core, prepared)
    flight = flight_of(core, vehicle)
    if flight is None:
        flight = Flight(owner=command.principal, vehicle=vehicle, core=core)
        await core.jobs.start(flight)
    flight.owner = command.principal
    was_sent = True
    flight.ordered()
    try:
        return await services.call(core, prepared)
    except RobotError as error:
        was_sent = not was_refused(error)
        raise
    finally:
        flight.answered(was_sent)


def flight_of(core: Core, vehicle: str) -> Flight | None:
    """The flight of a vehicle that has not ended."""
    return next((flight for flight in core.jobs.running(Flight) if flight.vehicle == vehicle), None)


def takes_setpoints(core: Core, topic: str) -> bool:
    """Whether a vehicle that is in flight takes its setpoints from that topic: it follows none when it is braked."""
    vehicle, found, _ = topic.rpartition("/setpoint_")
    return bool(found) and flight_of(core, vehicle) is not None
