"""A relay at work: a request to the bridge that stays open, and where values count, the server's part of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from time import monotonic

from ros2_mcp.guard.relays import Relay
from ros2_mcp.model import commands
from ros2_mcp.model.errors import BadData, BadValue, NotFound, RobotError
from ros2_mcp.model.graph import RelayCounts
from ros2_mcp.model.qos import mismatch
from ros2_mcp.model.samples import Sample
from ros2_mcp.robot import Listening, Robot
from ros2_mcp_bridge.rhythm import Rhythm

Transform = Callable[[Sample], "bytes | None"]
"""What becomes of a message: the bytes to publish, or None where it is held back."""

_FOREVER_S = 1e9
_LOOK_EVERY_S = 0.02
_BATCH = 100
_BATCH_BYTES = 1_000_000


def transform_of(robot: Robot, relay: Relay) -> Transform:
    """The server's part of a relay whose types have been learnt.

    Raises:
        BadInput: for tolerances or a mapping that do not fit the types.
    """
    from ros2_mcp.codec.change import ChangeDetector
    from ros2_mcp.codec.mapping import FieldMapping

    codec, kinds = robot.values.codec, (relay.source_type, relay.destination_type)
    change = ChangeDetector(codec, kinds[0], relay.tolerances) if relay.transform == "on_change" else None
    rhythm = Rhythm(relay.rate_hz) if relay.rate_hz else None
    mapping = FieldMapping(codec, *kinds, relay.mapping) if relay.mapping else None

    def transform(sample: Sample) -> bytes | None:
        if change is not None and not change.is_change(sample.data):
            return None
        if rhythm is not None and not rhythm.passes(sample.received_ns):
            return None
        return mapping.apply(sample.data) if mapping is not None else sample.data

    return transform


async def keep(robot: Robot, relay: Relay, command: commands.Relay, transform: Transform) -> None:
    """Runs a relay to its end, whatever ends it, and notes how it ended."""
    request = asyncio.ensure_future(robot.do(command))
    try:
        await _until_open(robot, relay, request)
        time_is_over = False
        if relay.in_server:
            time_is_over = await _pump_beside(robot, relay, request, transform)
        else:
            relay.state = "running"
        relay.counts = await request
        relay.state = "stopped" if relay.counts.cancelled and not time_is_over else "ended"
    except RobotError as error:
        relay.failure, relay.state = error, "failed"
    finally:
        request.cancel()


async def look(robot: Robot) -> None:
    """Brings the counts of all open relays up to date."""
    running = await robot.graph.relays()
    for relay in robot.relays.open:
        relay.counts = running.get(relay.relay_id, relay.counts)


async def _until_open(robot: Robot, relay: Relay, request: asyncio.Future[RelayCounts]) -> None:
    while not request.done() and not relay.counts.running:
        await look(robot)
        await asyncio.wait({request}, timeout=_LOOK_EVERY_S)


async def _pump_beside(robot: Robot, relay: Relay, request: asyncio.Future[RelayCounts], transform: Transform) -> bool:
    """Feeds the bridge until the time is over (true), or until the bridge has ended the relay."""
    pumping = asyncio.ensure_future(_pump(robot, relay, transform))
    try:
        await asyncio.wait({request, pumping}, return_when=asyncio.FIRST_COMPLETED)
        if request.done():
            return False
        await robot.end_relay(relay.relay_id)
        pumping.result()
        return True
    finally:
        pumping.cancel()
        await asyncio.wait({pumping})


async def _pump(robot: Robot, relay: Relay, transform: Transform) -> None:
    """Subscribes whenever publishers are there, so that the QoS fits those who come or come back."""
    relay.state = "running"
    end = monotonic() + relay.duration_s if relay.duration_s else float("inf")
    while (left := end - monotonic()) > 0:
        present = await robot.graph.wait_for(relay.source, publishers=1, timeout_s=min(left, 1.0))
        if present.publishers:
            async with robot.listen(relay.source, relay.source_type) as listening:
                await _pump_from(robot, relay, transform, listening, end)


async def _pump_from(robot: Robot, relay: Relay, transform: Transform, listening: Listening, end: float) -> None:
    """Feeds the bridge until the time is over or publishers are there that the subscription does not match."""
    dropped_before, lost_before = relay.dropped_here, relay.lost_here
    while (left := end - monotonic()) > 0:
        samples = await listening.take(min(left, 1.0))
        for start in range(0, len(samples), _BATCH):
            await _pass_on(robot, relay, transform, samples[start : start + _BATCH])
        counts = listening.counts
        relay.dropped_here = dropped_before + counts.dropped
        relay.lost_here = None if counts.lost is None or lost_before is None else lost_before + counts.lost
        if not samples and left > 1.0:
            there = (await robot.graph.endpoints(relay.source)).publishers
            if any(mismatch(publisher.qos, listening.choice.qos) for publisher in there):
                return


async def _pass_on(robot: Robot, relay: Relay, transform: Transform, samples: Sequence[Sample]) -> None:
    messages: list[bytes] = []
    for sample in samples:
        try:
            message = transform(sample)
        except (BadValue, BadData) as error:
            relay.failed += 1
            relay.last_trouble = str(error)
            continue
        if message is None:
            relay.held_back += 1
        else:
            messages.append(message)
    for batch in _batches(messages):
        await _feed(robot, relay, batch)


async def _feed(robot: Robot, relay: Relay, batch: Sequence[bytes]) -> None:
    feed = commands.Feed(
        principal=robot.principal,
        name=relay.destination,
        type=relay.destination_type,
        relay_id=relay.relay_id,
        messages=batch,
    )
    try:
        await robot.do(feed)
    except NotFound:
        await asyncio.sleep(_FOREVER_S)  # the bridge has ended the relay, and its answer to that is under way


def _batches(messages: Sequence[bytes]) -> Iterator[list[bytes]]:
    """The messages in their order, several together as long as they are small."""
    batch: list[bytes] = []
    size = 0
    for message in messages:
        if batch and size + len(message) > _BATCH_BYTES:
            yield batch
            batch, size = [], 0
        batch.append(message)
        size += len(message)
    if batch:
        yield batch
