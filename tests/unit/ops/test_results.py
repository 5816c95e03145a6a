"""What is said of values of the robot."""

from __future__ import annotations

from ros2_mcp.ops.results.results import in_words


def test_feedback_in_words_has_values_by_their_paths_and_times_in_seconds() -> None:
    feedback = {
        "current_pose": {"header": {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "map"}, "x": 1.23456},
        "navigation_time": {"sec": 3, "nanosec": 0},
        "path": [1, 2],
        "scan": {"$summary": "float32[]", "length": 360},
        "nothing": {},
    }
    said = in_words(feedback)
    assert said.startswith(
        "current_pose.header.stamp 12.500 s, current_pose.header.frame_id «map», current_pose.x 1.23, "
    )
    assert "navigation_time 3.000 s, path «[1,2]»" in said and "nanosec" not in said
