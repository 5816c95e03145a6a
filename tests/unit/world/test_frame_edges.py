"""What is known of an edge from when its messages come, circles that are hidden, and clocks that are not set."""

from __future__ import annotations

import pytest

from ros2_mcp.model.poses import Pose
from ros2_mcp.world.no_transform import located
from ros2_mcp.world.transforms import FrameTree
from support.made_frames import SECOND, at, follows, reason, robot, tell, transform

# ── messages that come many at once ──────────────────────────────────────────────────────────────────────────────────


def bursts(tree: FrameTree, count: int, each: int = 80, hz: float = 20.0) -> None:
    """Measured and stamped at that rate, and sent `each` at once."""
    for number in range(count * each):
        sent_s = (number // each + 1) * each / hz + (number % each) * 1e-5
        tell(tree, transform("odom", "base_link", stamp_ns=at(number / hz)), after_s=sent_s)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_an_edge_that_comes_in_bursts_has_the_rate_of_its_stamps_and_its_pauses_are_known(count: int) -> None:
    tree = FrameTree()
    bursts(tree, count)
    edge = tree.edges["base_link"]
    assert edge.rate_hz == pytest.approx(20.0)
    assert edge.bursts and edge.bursts.pause_ns == pytest.approx(4 * SECOND, rel=0.02) and edge.bursts.count == 80


def test_bursts_that_take_their_time_are_bursts_too() -> None:
    tree = FrameTree()
    for number in range(320):
        sent_s = (number // 80 + 1) * 4.0 + (number % 80) * 0.015  # 1.2 s for each
        tell(tree, transform("odom", "base_link", stamp_ns=at(number / 20)), after_s=sent_s)
    found = tree.edges["base_link"].bursts
    assert found and found.pause_ns == pytest.approx(2.8 * SECOND, rel=0.02)


def test_what_is_slow_or_stood_still_once_or_runs_on_simulated_time_comes_in_no_bursts() -> None:
    seldom, stalled, slow, fast = FrameTree(), FrameTree(), FrameTree(), FrameTree()
    for number in range(8):
        tell(seldom, transform("odom", "base_link", stamp_ns=at(number * 4)), after_s=number * 4)
    for number in range(400):
        stamp = transform("odom", "base_link", stamp_ns=at(number / 20))
        tell(stalled, stamp, after_s=max(number / 20, 7.0 if 100 < number < 140 else 0.0))
        tell(slow, transform("odom", "base_link", stamp_ns=number * SECOND // 20), after_s=number * 2.5)
        tell(fast, transform("odom", "base_link", stamp_ns=number * SECOND // 20), after_s=number / 200)
    assert [tree.edges["base_link"].bursts for tree in (seldom, stalled, slow, fast)] == [None] * 4
    assert slow.edges["base_link"].rate_hz == pytest.approx(20) and slow.edges["base_link"].received_hz < 1


# ── circles ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def reversed_mount() -> FrameTree:
    tree = FrameTree()
    tell(tree, transform("base_link", "laser"), transform("base_link", "imu"), static=True, sequence=1)
    tell(tree, transform("laser", "base_link"), static=True, sequence=1)
    follows(tree, "odom", "base_link", 0, 2)
    return tree


@pytest.mark.parametrize("pair", [("base_link", "laser"), ("laser", "base_link"), ("odom", "laser")])
def test_two_fixed_edges_that_are_each_others_reverse_are_a_circle_though_a_further_parent_hides_it(
    pair: tuple[str, str],
) -> None:
    why, words = reason(reversed_mount(), *pair)
    assert why == "circle" and "base_link is in laser" in words and "laser is in base_link" in words
    assert "base_link is in odom (10 Hz), too, which is not part of the loop." in words
    assert located(reversed_mount(), "base_link", "imu").pose == Pose(), "what is no part of it is still known"


# ── what else is known of the stamps ─────────────────────────────────────────────────────────────────────────────────


def test_stamps_near_1970_without_a_clock_in_the_graph_are_no_simulated_time() -> None:
    tree = FrameTree()
    for number in range(20):
        tell(tree, transform("odom", "base", stamp_ns=(140 * SECOND) + number * SECOND // 20), after_s=number / 20)
    follows(tree, "map", "odom", 0, 1, hz=20)
    assert "odom → base by simulated time" in reason(tree, "map", "base")[1]
    tree.has_clock = False
    why, words = reason(tree, "map", "base")
    assert why == "two clocks" and "simulated" not in words and "Synchronise the clock" in words
    assert "ends 53.9 years before" in words and "by the time since its machine started" in words


def test_of_a_recording_no_other_recording_is_advised() -> None:
    tree = robot()
    assert "Read older transforms from a recording" in reason(tree, "odom", "base_link", at(-4))[1]
    tree.is_recorded = True
    assert "Read older transforms from a recording" not in reason(tree, "odom", "base_link", at(-4))[1]
