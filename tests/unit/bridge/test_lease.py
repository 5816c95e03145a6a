"""The link lease lapses when the server is silent, and never because the bridge itself was late."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from ros2_mcp_bridge.lease import LinkLease
from ros2_mcp_common.wire.packets import PacketError

PATIENCE_S = 30.0
LEASE_S = 0.2


@pytest.fixture
def stream() -> Iterator[tuple[int, Callable[[bytes], int]]]:
    """The descriptor that is read, and what writes to it."""
    reading, writing = os.pipe()
    yield reading, lambda data: os.write(writing, data)
    os.close(reading)
    os.close(writing)


def test_there_is_no_lease_before_the_first_ping(stream) -> None:
    lapses = list[float]()
    lease = LinkLease(stream[0], lapses.append)
    threading.Timer(2 * LEASE_S, stream[1], [b"x"]).start()
    lease.wait_readable()
    assert lapses == []


def test_it_lapses_once_when_nothing_comes_and_is_there_again_with_the_next_ping(stream) -> None:
    told, write = list[tuple[float, float]](), stream[1]
    lease = LinkLease(stream[0], lambda silent_s: told.append((silent_s, time.monotonic())))
    for _ in range(2):
        write(b"x")
        lease.wait_readable()
        begun = time.monotonic()
        os.read(stream[0], 1)
        lease.renew(LEASE_S)
        threading.Timer(3 * LEASE_S, write, [b"x"]).start()
        lease.wait_readable()
        os.read(stream[0], 1)
        ((silent_s, at),) = told
        assert silent_s >= LEASE_S and at - begun >= LEASE_S
        told.clear()


def test_bytes_that_wait_unread_are_a_sign_of_life(stream) -> None:
    times = iter([0.0, 0.0, 60.0])  # at its making, before the look at the stream, after it
    lapses = list[float]()
    lease = LinkLease(stream[0], lapses.append, now=lambda: next(times), slept_s=lambda: 0.0)
    lease.renew(LEASE_S)
    stream[1](b"x")
    lease.wait_readable()
    assert lapses == []


def test_bytes_that_come_while_this_process_is_held_up_are_a_sign_of_life(stream) -> None:
    calls, lapses = list[float](), list[float]()

    def now() -> float:
        calls.append(0.0)
        if len(calls) != 3:
            return 0.0 if len(calls) < 3 else 60.0
        stream[1](b"x")  # after a look at the stream in vain
        return 60.0

    lease = LinkLease(stream[0], lapses.append, now=now, slept_s=lambda: 0.0)
    lease.renew(LEASE_S)
    lease.wait_readable()
    assert lapses == []


def test_a_machine_that_slept_for_longer_has_lapsed_even_if_bytes_come(stream) -> None:
    slept, lapses = iter([0.0, 0.0, 5.0]), list[float]()
    lease = LinkLease(stream[0], lapses.append, now=lambda: 0.0, slept_s=lambda: next(slept))
    lease.renew(LEASE_S)
    stream[1](b"x")
    lease.wait_readable()
    assert lapses == [5.0]


def test_at_rest_the_clock_is_looked_at_when_the_lease_ends_and_not_before(stream) -> None:
    for is_at_rest, most, least in ((True, 3, 3), (False, 30, 5)):
        looks, lapses = list[float](), list[float]()

        def slept_s(looks: list[float] = looks) -> float:
            looks.append(time.monotonic())
            return 0.0

        lease = LinkLease(stream[0], lapses.append, is_at_rest=lambda at_rest=is_at_rest: at_rest, slept_s=slept_s)
        lease.renew(10 * LEASE_S)
        threading.Timer(4 * LEASE_S, stream[1], [b"x"]).start()
        lease.wait_readable()
        os.read(stream[0], 1)
        assert lapses == [] and least <= len(looks) <= most


def test_a_sleep_before_the_lease_does_not_count(stream) -> None:
    slept, lapses = iter([0.0, 5.0, 5.0]), list[float]()
    lease = LinkLease(stream[0], lapses.append, now=lambda: 0.0, slept_s=lambda: next(slept))
    lease.renew(LEASE_S)
    stream[1](b"x")
    lease.wait_readable()
    assert lapses == []


def test_who_hears_nothing_for_too_long_has_no_server_any_more(stream) -> None:
    """Also before the first ping, and after a lease has lapsed."""
    lease = LinkLease(stream[0], lambda _: None, orphan_s=0.05)
    with pytest.raises(PacketError, match="nothing came for"):
        lease.wait_readable()
    lapses: list[float] = []
    lease = LinkLease(stream[0], lapses.append, orphan_s=0.2)
    lease.renew(0.05)
    with pytest.raises(PacketError):
        lease.wait_readable()
    assert len(lapses) == 1


def test_the_end_of_the_stream_is_no_silence(stream) -> None:
    reading, writing = os.pipe()
    lapses = list[float]()
    lease = LinkLease(reading, lapses.append)
    lease.renew(PATIENCE_S)
    os.close(writing)
    lease.wait_readable()
    assert os.read(reading, 1) == b"" and lapses == []
    os.close(reading)
