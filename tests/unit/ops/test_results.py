"""The text of a result keeps what is acted on, though the lines above it say it too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ros2_mcp.model.brief import EXPLAINED
from ros2_mcp.ops.results import as_json, in_brief, in_words

NOTE = "It has reached the place where it was sent."


@dataclass(frozen=True, slots=True)
class Row:
    topic_name: str
    note: str

    def summary(self) -> str:
        return f"{self.topic_name}: {self.note}"


@dataclass(frozen=True, slots=True)
class Sent:
    goal_id: str
    condition: str
    at: str
    note: str
    error: str
    topics: Sequence[Row]

    def summary(self) -> list[str]:
        own = f"{self.goal_id}: {self.condition} at {self.at}. {self.note}"
        return [own, *(topic.summary() for topic in self.topics)]


def test_only_sentences_that_have_been_said_are_dropped_and_none_of_a_lists_objects() -> None:
    row = Row("/a_robot_with_a_long_name/front/camera/image", NOTE)
    at = "2026-11-21T03:00:12.300456Z (12.3 s in)"
    sent = Sent("0123456789abcdef0123456789abcdef", "pose.position.x > 1.5 and speed < 2", at, NOTE, "", [row])
    shown, _ = in_brief(sent, as_json(sent), "\n".join(sent.summary()))
    assert shown == {
        "goal_id": sent.goal_id,
        "condition": sent.condition,
        "at": at,
        "topics": [{"topic_name": row.topic_name, "note": NOTE}],
    }


def test_the_words_for_equal_messages_say_that_they_are_equal_and_not_left_out() -> None:
    messages = [{"x": 1.0, "frame_id": "map"}] * 12
    shown, is_shortened = in_brief(messages, messages, "")
    assert is_shortened and shown == {"first": {"x": 1.0, "frame_id": "map"}, "same": 11}
    assert "without loss" in EXPLAINED and '"same" is how many further ones equal the first' in EXPLAINED


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
