"""Frames that are told to a tree, and why there is no transform between two of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ros2_mcp.model.errors import NoTransform
from ros2_mcp.world.no_transform import located
from ros2_mcp.world.transforms import FrameTree

SECOND = 1_000_000_000
NOW_NS = 1_700_000_000 * SECOND


def transform(
    parent: str,
    child: str,
    at: tuple[float, ...] = (0.0, 0.0, 0.0),
    q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
    stamp_ns: int = NOW_NS,
) -> Any:
    sec, nanosec = divmod(stamp_ns, SECOND)
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=parent, stamp=SimpleNamespace(sec=sec, nanosec=nanosec)),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(**dict(zip("xyz", at, strict=True))),
            rotation=SimpleNamespace(**dict(zip("xyzw", q, strict=True))),
        ),
    )


def tell(tree: FrameTree, *transforms: Any, static: bool = False, after_s: float = 0.0, sequence: int | None = None):
    """One message, received `after_s` after `NOW_NS`."""
    message = SimpleNamespace(transforms=transforms)
    tree.add(message, NOW_NS + round(after_s * SECOND), is_static=static, sequence=sequence)


def at(seconds: float) -> int:
    return NOW_NS + round(seconds * SECOND)


def follows(tree: FrameTree, parent: str, child: str, first_s: float, last_s: float, hz: float = 10.0) -> None:
    """An edge that is told at that rate."""
    for number in range(round((last_s - first_s) * hz) + 1):
        seconds = first_s + number / hz
        tell(tree, transform(parent, child, (seconds, 0.0, 0.0), stamp_ns=at(seconds)), after_s=seconds)


def reason(tree: FrameTree, target: str, frame: str, at_ns: int | None = None) -> tuple[str, str]:
    with pytest.raises(NoTransform) as raised:
        located(tree, target, frame, at_ns)
    return raised.value.reason, str(raised.value)


def robot() -> FrameTree:
    """map → odom → base_link → laser, for ten seconds."""
    tree = FrameTree()
    follows(tree, "map", "odom", 0, 10)
    follows(tree, "odom", "base_link", 0, 10)
    tell(tree, transform("base_link", "laser"), static=True)
    return tree
