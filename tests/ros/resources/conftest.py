"""The real server over real stdio, and a robot to which things happen on command."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
sys.path.insert(0, str(Path(__file__).parent))  # the tests import their neighbours

from events_process import EventsPeer
from listener import HANDSHAKE, MODERN, Listener


@pytest.fixture(scope="session")
def events(ros_environment: dict[str, str]) -> Iterator[EventsPeer]:
    """A robot to which things happen on command."""
    peer = EventsPeer(ros_environment)
    yield peer
    peer.end()


@pytest.fixture(scope="session", params=[HANDSHAKE, MODERN])
def listener(request: pytest.FixtureRequest, ros_environment: dict[str, str], events: EventsPeer) -> Iterator[Listener]:
    """A raw client of each era."""
    server = Listener(ros_environment, "--tools", "all")
    server.begin(request.param)
    yield server
    server.end()
