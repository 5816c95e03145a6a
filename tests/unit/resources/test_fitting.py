"""What a resource says fits, and says what it leaves out."""

from __future__ import annotations

import json

from ros2_mcp.resources.fitting import fitting


def test_what_fits_is_given_whole() -> None:
    assert json.loads(fitting({"topics": ["/scan"], "note": ""}, 1000)) == {"topics": ["/scan"], "note": ""}


def test_a_long_list_is_cut_and_the_cut_is_said() -> None:
    text = fitting({"topics": [f"/topic_{i:04}" for i in range(1000)], "note": "all"}, 4000)
    shown = json.loads(text)
    assert len(text) <= 4000
    assert shown["topics"] == [f"/topic_{i:04}" for i in range(len(shown["topics"]))]
    assert shown["omitted"] == {"topics": f"the first {len(shown['topics'])} of 1000 entries are shown"}
    assert shown["note"] == "all"


def test_lists_give_way_before_what_cannot_be_parted() -> None:
    shown = json.loads(fitting({"sample": {"data": "x" * 2000}, "publishers": ["/a_node"] * 500}, 3000))
    assert shown["sample"]["data"] == "x" * 2000
    assert len(shown["publishers"]) < 500


def test_what_cannot_be_parted_is_left_out_with_its_size() -> None:
    shown = json.loads(fitting({"examples": {"value": "x" * 5000}, "kind": "msg"}, 500))
    assert shown["examples"] is None
    assert shown["omitted"]["examples"] == "5012 bytes"
    assert shown["kind"] == "msg"


def test_hidden_text_of_a_robot_becomes_visible_and_what_is_seen_stays() -> None:
    text = fitting({"message": "go\u202eback\u200b, Grüße 漢字 😀"}, 1000)
    assert json.loads(text)["message"] == "go⟦U+202E⟧back⟦U+200B⟧, Grüße 漢字 😀"


def test_the_size_is_counted_in_bytes_with_what_was_escaped() -> None:
    for text in ("漢" * 4000, "\u202e\u200b" * 2000):
        assert len(fitting({"message": text, "note": ""}, 4000).encode()) <= 4000
