"""What counts as heard of a robot's frames."""

from __future__ import annotations

import asyncio
import math
from time import monotonic
from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.ops.space.first_heard import frames_heard
from ros2_mcp.world.transforms import FrameTree


class Listener:
    """A listener that hears nothing new."""

    def __init__(self, tree: FrameTree) -> None:
        self.tree = tree
        self.waits = 0

    async def news(self, timeout_s: float) -> None:
        self.waits += 1
        await asyncio.sleep(timeout_s)


@pytest.mark.parametrize(("x", "is_static", "waits"), [(1.0, False, 0), (math.nan, False, 0), (1.0, True, 1)])
async def test_a_transform_that_is_refused_was_heard_and_a_static_one_beside_tf_is_not_all(
    x: float, is_static: bool, waits: int
) -> None:
    tree = FrameTree()
    turned = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    transform = SimpleNamespace(translation=SimpleNamespace(x=x, y=0.0, z=0.0), rotation=turned)
    header = SimpleNamespace(frame_id="odom", stamp=SimpleNamespace(sec=7, nanosec=0))
    one = SimpleNamespace(header=header, child_frame_id="base_link", transform=transform)
    tree.add(SimpleNamespace(transforms=[one]), 7 * 10**9, is_static=is_static)
    listener: Any = Listener(tree)
    await frames_heard(listener, ["/tf", "/tf_static"], monotonic() + 0.3)
    assert min(listener.waits, 1) == waits
