"""Which URI stands for what."""

from __future__ import annotations

import pytest

from ros2_mcp.model.errors import BadInput, BadName, NotFound
from ros2_mcp.ops.watch.changes import GoalsEnded, GraphParts, LogLines, ParametersOf, TopicSamples, Unchanging
from ros2_mcp.resources.catalogue import RESOURCES, subject_of


@pytest.mark.parametrize(
    "uri",
    ["ros2://topic/arm/state", "ros2://topic//arm/state", "ros2://topic/%2Farm%2Fstate", "ros2://topic/arm%2Fstate"],
)
def test_every_spelling_of_a_name_with_slashes_is_the_same_topic(uri: str) -> None:
    assert subject_of(uri) == TopicSamples("/arm/state")


@pytest.mark.parametrize(
    ("uri", "subject"),
    [
        ("ros2://nodes", GraphParts(("nodes",))),
        ("ros2://actions", GoalsEnded()),
        ("ros2://log", LogLines()),
        ("ros2://log?level=WARN", LogLines("warn")),
        ("ros2://log?node=/lidar&level=error", LogLines("error", "/lidar")),
        ("ros2://node//arm/driver/parameters", ParametersOf("/arm/driver")),
        ("ros2://interface/sensor_msgs/msg/Image", Unchanging()),
    ],
)
def test_a_uri_says_what_is_watched(uri: str, subject: object) -> None:
    assert subject_of(uri) == subject


def test_a_uri_of_nobody_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(NotFound, match="Did you mean ros2://topics"):
        subject_of("ros2://topic")


def test_what_ros_does_not_allow_is_refused() -> None:
    with pytest.raises(BadName):
        subject_of("ros2://topic/1st%20topic")
    with pytest.raises(BadInput, match="warn"):
        subject_of("ros2://log?level=wran")


def test_names_of_resources_are_unique() -> None:
    assert len({declared.name for declared in RESOURCES}) == len(RESOURCES)
