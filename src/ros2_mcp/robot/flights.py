"""Flights: jobs that an autopilot carries out, and the orders that start them.

A mode, arming, a take-off, a landing, a mission or a command through MAVROS makes a vehicle move, and the motion goes
on after the call has been answered. It is therefore a job. It is stopped by a mode in which the vehicle holds its
position, never by disarming.
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
"""The time limit for the brake mode to appear in the vehicle's state, in s. MAVROS answers within milliseconds, and
reports the new mode with the autopilot's next heartbeat, once per second."""
_CALL_S = 1.0
"""The time limit for the answer to one brake mode, in s."""
_EFFECT_S = 2.0
"""The time after the answer to an order during which the state may lack its effect, in s: two heartbeats at 1 Hz."""
_AGAIN_S = 1.0
"""The pause between attempts to subscribe to a vehicle's state, in s, if it has no publisher or the bridge was lost."""
_CLOSE_S = 0.5
"""The time limit for unsubscribing, in s: a bridge that lives answers within milliseconds, and the end of the server
does not wait longer for another."""
_MOST_STATES, _MOST_STATE_BYTES = 50, 100_000
"""Bounds on the waiting messages of the state: one arrives each second, and with each change."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Braked:
    """The result of a brake order.

    `mode` is the mode that the vehicle accepted ("" if none is known to be sent), `confirmed` whether its state
    reported that mode, and `error` the reason if not.
    """

    mode: str
    confirmed: bool
    error: str = ""


class Flight(Job):
    """One vehicle that this server has sent an order to.

    `vehicle` is the name of its MAVROS, such as `/mavros`; `mode` and `armed` are the last reported values ("" and None
    before the first report). The flight runs until the vehicle is reported disarmed.
    """

    kind = "flight"
    most_running = 16
    """The most vehicles at a time: more than one server is used for."""
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
        """Whether the flight has not ended yet. Changes at once, before the job's task ends."""
        return super().is_running and not self._has_ended.is_set()

    @property
    def comes_down(self) -> bool:
        """Whether the vehicle returns or lands on its own."""
        return self.mode in DESCENT_MODES

    async def run(self) -> None:
        """Follow the vehicle's state until it is disarmed. If the job is abandoned earlier, its fail-safe stays in
        force.
        """
        self.begun()
        async with anyio.create_task_group() as group:
            group.start_soon(self._follow)
            await self._has_ended.wait()
            group.cancel_scope.cancel()

    def ordered(self) -> None:
        """Register an order that is about to be sent: the flight does not end before its effect is reported."""
        self._under_way += 1
        self._core.failsafes.leave_brake(self.vehicle)

    def answered(self, was_sent: bool) -> None:
        """Record that the order was answered, or is known not to have been sent."""
        self._under_way -= 1
        self._ordered_ns = self._core.now_ns()
        if not was_sent and not self._under_way and not self.armed:
            self._end()

    async def stop(self) -> None:
        """Make the vehicle hold its position, because its client has gone, unless it already descends.

        The flight runs until the vehicle is reported disarmed, because it may move until then.
        """
        if self.is_stopping:  # the job was abandoned: the bridge's fail-safe brakes the vehicle
            await self.wait()
        elif self.is_running and not self.comes_down:
            braked = await self.brake()
            if braked.error:
                _logger.warning("%s could not be brought to hold its position: %s", self.vehicle, braked.error)

    async def brake(self) -> Braked:
        """Order the best brake mode that the vehicle has, and wait for its state to confirm it.

        Never raises a `RobotError`. A brake does not pass the policy, and no stop holds it back.
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
        """Wait until a condition on the vehicle's state holds; return whether it does."""
        with anyio.move_on_after(within_s):
            while not holds():
                self._news.clear()
                await self._news.wait()
        return holds()

    async def _order_to_stand(self) -> str:
        """Return the first brake mode that MAVROS accepts; "" if it accepts none."""
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
        """Follow the vehicle's state across restarts of the bridge."""
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
                # MAVROS keeps its last ten states for late subscribers: of those from before, only the newest counts.
                samples = [sample for sample in samples if _said_ns(sample) >= began_ns] or samples[-1:]
                for sample, state in zip(samples, await core.values.decode_all(STATE_TYPE, samples), strict=True):
                    self._hear(state, _said_ns(sample))
        finally:
            with anyio.move_on_after(_CLOSE_S, shield=True):  # a cancelled scope cancels every await again
                await subscription.close()

    def _hear(self, state: Any, said_ns: int) -> None:
        self.mode, self.armed = str(state.mode), bool(state.armed)
        self._news.set()
        if self.comes_down and not self._under_way:  # an order in progress may end its descent, and needs the fail-safe
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
    """Return when a sample was published, by the robot's clock, in ns."""
    return sample.source_ns or sample.received_ns  # some middlewares provide no source time


async def call(core: Core, prepared: Prepared[ServiceCall]) -> Answer:
    """Carry out a service call. An order to a vehicle becomes a flight before it is sent.

    Raises as `services.call`.
    """
    command = prepared.command
    vehicle = vehicle_of(command.name, command.type)
    if not vehicle or only_asks(command.type, command.value):
        return await services.call(core, prepared)
    await prepared.body()  # an order with an invalid value starts no flight
    core.check_stop(prepared.session)
    try:
        await core.values.learn(SET_MODE)
    except UnknownInterface:  # the brake's type is unknown here, so there can be no flight
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
    """Return the running flight of a vehicle, or None."""
    return next((flight for flight in core.jobs.running(Flight) if flight.vehicle == vehicle), None)


def takes_setpoints(core: Core, topic: str) -> bool:
    """Return whether a vehicle in flight takes its setpoints from this topic: once braked, it ignores them."""
    vehicle, found, _ = topic.rpartition("/setpoint_")
    return bool(found) and flight_of(core, vehicle) is not None
