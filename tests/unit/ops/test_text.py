"""The text of a result says all that an agent acts on, once, and so that it can be read and sent back."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from ros2_mcp.ops.results.results import EXACT, HIDDEN, IF_ANY, LINES, SAID, PictureFacts, beside
from ros2_mcp.ops.results.text import as_text
from support.hidden import HIDDEN as HIDDEN_TEXTS
from support.outlets import FORGED, hostile, is_hidden

NOTE = "It has reached the place where it was sent."


@dataclass(frozen=True, kw_only=True)
class Messages:
    topic_name: str = field(default="/odom", metadata=SAID)
    messages: Sequence[Mapping[str, Any]] = ()
    times_s: Sequence[float] = field(default=(), metadata=beside("messages"))
    note: str = field(default="", metadata=IF_ANY)

    def summary(self) -> str:
        return f"{self.topic_name}: {len(self.messages)} message(s)."


@dataclass(frozen=True)
class Row:
    name: str
    count: int
    rate_hz: float | None = None
    nodes: Sequence[str] = ()
    problem: str = ""
    secret: str = field(default="hidden", metadata=HIDDEN)


@dataclass(frozen=True)
class Group:
    node: str
    rows: Sequence[Row]


@dataclass(frozen=True)
class Place:
    x: float
    y: float


@dataclass(frozen=True, kw_only=True)
class Whole:
    verdict: str = field(default="HEALTHY", metadata=SAID)
    count: int = 3
    age_s: float = 0.123456789
    name: str = "/a"
    text: str = "two words"
    place: Place = field(default=Place(1 / 3, 2 / 3), metadata=EXACT)
    spread: Place | None = None
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])
    definition: str = field(default="", metadata=LINES)
    rows: Sequence[Row] = ()
    groups: Sequence[Group] = ()
    names: Sequence[str] = ()
    problems: Sequence[str] = ()
    pictures: Sequence[PictureFacts] = ()
    note: str = ""

    def summary(self) -> list[str]:
        return [f"{self.verdict}."]


def put(message: Any, path: str, value: Any) -> None:
    *way, last = [int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", path)]
    for part in way:
        message = message[part]
    message[last] = value


def restored(text: str) -> list[Any]:
    """The messages that a reader makes of it, going by its words alone."""
    _, title, *lines = [line for line in text.splitlines() if not line.startswith('{"$diagonal": […]}')]
    if ": {" in title:
        return [json.loads(title.partition(": ")[2])]
    count = int(re.findall(r"\((\d+)\)", title)[0])
    if "all equal" in title:
        return [json.loads(lines[0])] * count
    if "first whole" not in title:
        return [json.loads(line.rpartition(" | ")[2]) for line in lines if "{" in line]
    first, rows = lines[0], lines[1:]
    if "by path" in title:
        rows = rows if rows[0].startswith("{") else rows[1:]
        changes: list[dict[str, Any]] = [{}, *(json.loads(row.rpartition(" | ")[2]) for row in rows)]
    else:
        names = [json.loads(name) if name.startswith('"') else name for name in rows[0].split(" | ")]
        cells = [dict(zip(names, map(json.loads, row.split(" | ")), strict=True)) for row in rows[1:]]
        changes = [{name: value for name, value in row.items() if name != "times_s"} for row in cells]
    found: list[Any] = []
    for change in changes:
        message = json.loads(first)
        for path, value in change.items():
            put(message, path, value)
        found.append(message)
    assert len(found) == count
    return found


def odometry(number: int) -> dict[str, Any]:
    return {
        "header": {"stamp": {"sec": 7, "nanosec": number}, "frame_id": "odom"},
        "pose": {"x": number / 3, "covariance": [0.5] * 9},
        "twist": {"linear": {"x": 0 if number else -0.0}, "name": ["a | b", "c"][: number % 3]},
    }


@pytest.mark.parametrize(
    ("messages", "form"),
    [
        ([odometry(1)], "messages (1): {"),
        ([odometry(number) for number in range(10)], "the first whole, then the differences of each:"),
        ([{"ranges": [number] * 40, "angle": 1.5} for number in range(5)], "messages (5):\n"),
        ([{f"joint_{joint}": number * (joint < 20) for joint in range(80)} for number in range(3)], "by path:"),
        ([odometry(4)] * 6, "messages (6), all equal:"),
        ([{"a": 1}, {"b": "x"}], "messages (2):"),
    ],
)
@pytest.mark.parametrize("with_times", [False, True])
def test_messages_are_told_once_and_nothing_is_lost(messages: list[Any], form: str, with_times: bool) -> None:
    times = [number / 10 for number in range(len(messages))] if with_times else []
    text = as_text(Messages(messages=messages, times_s=times))
    assert form in text
    assert json.dumps(restored(text)) == json.dumps(messages)
    assert ("0.1 | " in text or "0.1\n" in text) == (with_times and len(messages) > 1 and "all equal" not in text) or (
        "all equal" in text
    )


def test_the_summary_stands_first_and_the_note_last() -> None:
    text = as_text(Whole(note="Some are missing.", rows=[Row("a", 1), Row("b", 2)]), ["A default was taken."])
    assert text.splitlines()[:2] == ["HEALTHY.", "A default was taken."]
    assert text.splitlines()[-1] == "note: Some are missing."


def test_what_the_summary_says_is_not_said_again() -> None:
    assert "verdict" not in as_text(Whole())
    assert as_text(Whole(), [NOTE, NOTE]).count(NOTE) == 1


def test_short_values_share_a_line_and_measured_numbers_are_short() -> None:
    assert 'count: 3, age_s: 0.1235, name: /a, text: "two words"' in as_text(Whole())


def test_what_is_empty_is_left_out() -> None:
    text = as_text(Whole(text=""))
    assert not [name for name in ("text", "spread", "values", "rows", "names", "note", "null") if name in text]


def test_what_can_be_sent_back_is_exact() -> None:
    assert 'place: {"x":0.3333333333333333,"y":0.6666666666666666}' in as_text(Whole())


def test_a_list_of_objects_is_a_table_and_what_is_equal_in_all_is_said_once() -> None:
    rows = [Row("/scan", 1, 10.01234, ("/lidar",)), Row("/odom", 1, 25.0, ("/base", "/sim"), "slow | late")]
    lines = as_text(Whole(rows=rows)).splitlines()
    at = lines.index("rows (2; every row has count: 1):")
    assert lines[at + 1 : at + 4] == [
        "name | rate_hz | nodes | problem",
        "/scan | 10.012 | /lidar",
        '/odom | 25 | /base, /sim | "slow \\u007c late"',
    ]


def test_one_object_is_a_line_of_its_own() -> None:
    assert "rows (1): name: /scan, count: 1" in as_text(Whole(rows=[Row("/scan", 1)]))


def test_objects_with_a_list_each_share_the_header_of_one_table() -> None:
    groups = [Group("/a", [Row("x", 1), Row("y", 2)]), Group("/b", [Row("z", 3)])]
    lines = as_text(Whole(groups=groups)).splitlines()
    at = lines.index("groups (2), rows of each:")
    assert lines[at + 1 :] == ["name | count", "node: /a", "x | 1", "y | 2", "node: /b", "z | 3"]


def test_pictures_are_told_by_their_size() -> None:
    assert "picture: 320 x 240 px, rgb8." in as_text(Whole(pictures=[PictureFacts(320, 240, "image/jpeg", "rgb8.")]))


@pytest.mark.parametrize("what", [*HIDDEN_TEXTS, ""])
def test_a_text_of_the_robot_forges_no_line_and_no_column(what: str) -> None:
    bad = hostile(what) + " | true"
    result = Whole(
        name=bad,
        text=bad,
        values={bad: bad},
        definition=f"{bad}\n{bad}",
        rows=[Row(bad, 1), Row("b", 2, nodes=(bad, bad))],
        groups=[Group(bad, [Row(bad, 1)]), Group("b", [Row(bad, 2, nodes=(bad,))])],
        names=[bad, "b"],
        pictures=[PictureFacts(1, 1, "image/png", bad)],
    )
    text = as_text(result)
    assert not [character for character in text if is_hidden(character)]
    assert not [line for line in text.splitlines() if line.startswith((FORGED, "|", " | "))]
    head, *rows = [line for line in text.splitlines() if line.startswith("name | ") or " | " in line]
    assert {line.count(" | ") for line in rows} <= set(range(head.count(" | ") + 1))


def test_a_text_that_is_too_long_loses_rows_and_says_how_many_and_how_to_get_them() -> None:
    rows = [Row(f"/topic_{number}", number) for number in range(2000)]
    text = as_text(Whole(rows=rows, note=NOTE), most=3000, narrowing=("pattern", "limit"))
    assert len(text) <= 3000
    assert text.startswith("HEALTHY.\n")
    shown = [line for line in text.splitlines() if line.startswith("/topic_")]
    assert 50 < len(shown) < 2000
    assert shown[-1] == f"/topic_{len(shown) - 1} | {len(shown) - 1}"
    assert NOTE in text
    assert f"the last {2000 - len(shown)} of 2000 rows of rows" in text
    assert text.endswith("ask for less at once: pattern, limit.")


def test_a_value_that_is_too_long_by_itself_is_not_cut() -> None:
    text = as_text(Whole(values={"long": "x" * 5000}, note=NOTE), most=3000)
    assert len(text) <= 3000 and "xxx" not in text and NOTE in text
    assert "values (50" in text


def test_a_summary_of_many_lines_leaves_room_for_what_stands_below() -> None:
    @dataclass(frozen=True)
    class Long:
        rows: Sequence[Row]

        def summary(self) -> list[str]:
            return [f"{row.name}: {row.count}" for row in self.rows]

    text = as_text(Long([Row(f"/topic_{number}", number) for number in range(2000)]), most=4000)
    assert len(text) <= 4000 and text.startswith("/topic_0: 0\n") and "/topic_0 | 0" in text
    assert "rows of the summary" in text
