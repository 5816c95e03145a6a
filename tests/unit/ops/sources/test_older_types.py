"""Recordings without definitions of messages that have changed since are read as those who wrote them meant it."""

from __future__ import annotations

import asyncio
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from ros2_mcp.compose.server import SOURCE_KINDS
from ros2_mcp.mcp.toolset import Toolset
from ros2_mcp.ops.memory.bag_store import BagStore
from support.made_bridge import MadeBridge, robot_of

TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
    "offered_qos_profiles TEXT)"
)
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
START_NS = 1_600_000_000_000_000_000


def recorded(path: Path, kind: str, messages: list[bytes]) -> None:
    """A file as rosbag2 wrote it before Iron: it has no definitions."""
    file = sqlite3.connect(path)
    file.execute(TOPICS)
    file.execute(MESSAGES)
    file.execute("INSERT INTO topics VALUES (1, '/old', ?, 'cdr', '')", (kind,))
    rows = [(number, START_NS + number * 10**8, data) for number, data in enumerate(messages, 1)]
    file.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", rows)
    file.commit()
    file.close()


def made(store: Stores, kind: str, **values: Any) -> bytes:
    """A message of a distribution, with empty or zero for what is not given."""
    types = get_typestore(store)

    def of(name: str, given: dict[str, Any]) -> Any:
        fields: dict[str, Any] = {}
        for field, (form, inner) in types.fielddefs[name][1]:
            if field in given:
                fields[field] = given[field]
            elif int(form) == 2:
                fields[field] = of(inner, {})
            elif int(form) == 1:
                fields[field] = "" if inner[0] == "string" else False if inner[0] == "bool" else 0
            else:
                fields[field] = np.zeros(0) if "float64" in str(inner) else []
        return types.types[name](**fields)

    return bytes(types.serialize_cdr(of(kind, values), kind))


async def read(folder: Path) -> dict[str, Any]:
    store = BagStore(folder)
    tools = Toolset(robot_of(MadeBridge()), store, ["all"], SOURCE_KINDS)
    asked = {"bag": "old", "topic_name": "/old"}
    result = await tools.call("ros2_bag_read", asked, lambda *_: asyncio.sleep(0))
    await store.close()
    return result.structured_content or {}


@pytest.mark.parametrize(
    ("written_by", "kind", "values", "told"),
    [
        (Stores.ROS2_HUMBLE, "sensor_msgs/msg/Range", {"range": 1.25}, "ROS 2 Humble"),
        (Stores.ROS2_FOXY, "visualization_msgs/msg/Marker", {"text": "door", "id": 7}, "ROS 2 Galactic"),
        (Stores.ROS2_GALACTIC, "shape_msgs/msg/SolidPrimitive", {"type": 3}, "ROS 2 Galactic"),
        (Stores.ROS2_JAZZY, "sensor_msgs/msg/Range", {"range": 2.5, "variance": 0.5}, ""),
    ],
)
async def test_the_newest_definition_that_fits_is_taken_and_told(
    tmp_path: Path, written_by: Stores, kind: str, values: dict[str, Any], told: str
) -> None:
    recorded(tmp_path / "old.db3", kind, [made(written_by, kind, **values)] * 2)
    for _ in range(2):  # also where the type is known by now
        found = await read(tmp_path)
        assert [{name: message[name] for name in values} for message in found["messages"]] == [values] * 2
        assert (told in found.get("note", "")) and ("Read as" in found.get("note", "")) == bool(told)


async def test_bytes_that_no_distribution_knows_stay_undecodable(tmp_path: Path) -> None:
    recorded(tmp_path / "old.db3", "sensor_msgs/msg/Range", [b"\0\1\0\0\7"] * 2)
    found = await read(tmp_path)
    assert found["messages"] == [] and "Read as" not in found.get("note", "")
