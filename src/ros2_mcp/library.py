"""A robot without MCP: for `assembly`, and for programs that use the operations of `ros2_mcp.ops` as a library."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import anyio

from ros2_mcp.guard.policy import Policy
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import SERVER
from ros2_mcp.ops.memory.bag_store import BagStore
from ros2_mcp.ops.sources.recorded_robot import recorded_robot
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings


@asynccontextmanager
async def connect(settings: Settings | None = None) -> AsyncGenerator[Robot, None]:
    """The robot that the settings name, or the environment without them; a recording where they name a bag.

    Returns at once: operations wait for the bridge themselves, and raise `RobotError` if there is none. When it is
    left, everything that was set in motion is stopped.
    """
    settings = settings or Settings.from_environment()
    store = store_for(settings)
    robot = robot_for(settings, store)
    robot.principal = SERVER
    async with running(robot, store):
        yield robot


def store_for(settings: Settings) -> BagStore:
    """The bags that the settings name."""
    return BagStore(settings.record_dir, settings.bag_dir, settings.bag)


def robot_for(settings: Settings, store: BagStore, bridge: Bridge | None = None) -> Robot:
    """The robot that the settings name; nothing is started. Without a `bridge` that is coming up, one is made."""
    if store.subject:
        return recorded_robot(store, settings.result_bytes)
    return Robot(bridge or Bridge(lambda: start_carrier(settings)), Policy(settings.read_only), settings.result_bytes)


@asynccontextmanager
async def running(robot: Robot, store: BagStore) -> AsyncGenerator[None, None]:
    """While it is entered the bridge is there, if there is a robot; at the end all work is ended.

    Jobs end first, as long as the bridge can still stop what they move; the bridge leaves the robot last.
    """
    if not store.subject:
        await robot.bridge.attach()
    try:
        yield
    finally:
        with anyio.CancelScope(shield=True):  # who is cancelled leaves the robot stopped all the same
            try:
                await robot.jobs.close()
            finally:
                try:
                    await store.close()
                finally:
                    await robot.bridge.close()
                    robot.failsafes.close()
