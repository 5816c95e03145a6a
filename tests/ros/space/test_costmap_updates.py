"""A costmap that is sent whole once, and then only where it changes, as Nav2 does it."""

from __future__ import annotations

import base64
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")
pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp_interfaces import build, default_cache
from support.agent import Agent, agent_for, until
from support.processes import SOURCES, peer_command, running

COSTMAP, CELL_M = "/global_costmap/costmap", 0.1
LETHAL, INSCRIBED = 254, 253
MAGENTA, CYAN = (255, 0, 255), (0, 255, 255)


@pytest.fixture(scope="module")
def known(ros_environment: dict[str, str]) -> dict[str, str]:
    """The environment of processes that know map_msgs and these messages of nav2_msgs."""
    interfaces = SOURCES / "ros2_mcp_demo" / "interfaces"
    prefixes = build([interfaces / "map_msgs", interfaces / "nav2_msgs"], default_cache(), lambda _line: None)
    sites = [str(each / "site-packages") for each in prefixes]
    return {
        **ros_environment,
        "AMENT_PREFIX_PATH": os.pathsep.join(map(str, [*prefixes, sys.prefix])),
        "PYTHONPATH": os.pathsep.join([*sites, ros_environment["PYTHONPATH"]]),
    }


@pytest.fixture
def peer(known: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    with running(known, *peer_command("costmap_peer")) as process:
        yield process


def change(peer: subprocess.Popen[str], x: int, y: int, cost: int = LETHAL) -> list[bool]:
    """Two by two cells get a cost; whether somebody heard it: of the grid, of the raw one."""
    assert peer.stdin and peer.stdout
    peer.stdin.write(json.dumps({"x": x, "y": y, "width": 2, "height": 2, "cost": cost}) + "\n")
    peer.stdin.flush()
    return json.loads(peer.stdout.readline())


def shown(agent: Agent, x: int, y: int, topic: str = COSTMAP) -> tuple[tuple[int, ...], str]:
    """The colour where the cells (x, y) and their neighbours meet, and what the scene says of the costmap."""
    result = agent.whole("ros2_scene", {"grid": topic})
    assert not result.is_error, result.content
    facts, [picture] = result.structured_content or {}, [part for part in result.content if part.type == "image"]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.data))).convert("RGB"))
    row = facts["top_px"] + (facts["y_max_m"] - (y + 1) * CELL_M) / facts["metres_per_pixel"]
    column = facts["left_px"] + ((x + 1) * CELL_M - facts["x_min_m"]) / facts["metres_per_pixel"]
    # between two labelled lines, of which one may lie upon the corner itself
    colours = [tuple(int(part) for part in pixels[int(row) + away, int(column) + away]) for away in (-4, 4)]
    said = [line for line in facts["missing"] if topic in line]
    assert colours[0] == colours[1], colours
    return colours[0], " ".join(said)


def shown_whole(agent: Agent, topic: str) -> tuple[tuple[int, ...], str] | None:
    """What is shown of a costmap that nobody has changed; None until it is there, which on a busy machine is late."""
    colour, said = shown(agent, 5, 5, topic)
    return (colour, said) if "no update since" in said else None


def test_what_changes_is_shown_from_the_first_question_on_and_what_is_not_known_is_told(
    known: dict[str, str], peer: subprocess.Popen[str]
) -> None:
    """Of the grid, and of the raw costmap, which nobody has listened to until then."""
    with agent_for(known, "--tools", "all") as agent:
        for index, topic in enumerate((COSTMAP, f"{COSTMAP}_raw")):
            agent.knows(topic, f"{topic}_updates")
            x, y = 12 + 4 * index, 20
            assert not change(peer, 5, 5)[index], "nobody listens yet"
            colour, said = until(lambda topic=topic: shown_whole(agent, topic))
            assert colour != MAGENTA, "Nav2 tells it to nobody"
            assert "no update since. Updates from before this server first listened" in said

            until(lambda index=index, x=x, y=y: change(peer, x, y)[index])
            until(lambda topic=topic, x=x, y=y: shown(agent, x, y, topic)[0] == MAGENTA)
            change(peer, x, y, INSCRIBED)
            until(lambda topic=topic, x=x, y=y: shown(agent, x, y, topic)[0] == CYAN)
            assert "; updates since: " in shown(agent, x, y, topic)[1]


def occupied(agent: Agent) -> tuple[int, str]:
    """How many cells the picture of the map shows occupied, and what is said of changes."""
    result = agent.whole("ros2_get_map_as_image", {"topic_name": COSTMAP})
    assert not result.is_error, result.content
    facts = result.structured_content or {}
    return round(facts["occupied"] * facts["width"] * facts["height"]), facts["note"]


def test_the_picture_of_the_map_shows_what_changes_too(known: dict[str, str], peer: subprocess.Popen[str]) -> None:
    with agent_for(known, "--tools", "all") as agent:
        agent.knows(COSTMAP, f"{COSTMAP}_updates")
        cells, said = occupied(agent)
        assert (cells, "Updates from before this server first listened" in said) == (0, True)
        until(lambda: change(peer, 12, 20)[0])
        until(lambda: occupied(agent)[0] == 4)
        assert "; updates since: " in occupied(agent)[1]
