"""A picture of the only map or cloud there is needs no name."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.pictures import OCCUPANCY_GRID, POINT_CLOUD
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.sources.only import only_topic
from ros2_mcp.ops.sources.source import GraphSnapshot, Source
from ros2_mcp.robot import TopicEndpoints
from ros2_mcp.values.cdr import Codec
from support.made_windows import CODEC


class Listed(Source):
    """A source that has these topics; each has one publisher."""

    words = "made"

    def __init__(self, **topics: str) -> None:
        self._topics = {f"/{name.replace('__', '/')}": kind for name, kind in topics.items()}

    @property
    def codec(self) -> Codec:
        return CODEC

    async def type_of(self, topic: str) -> str:
        return self._topics[topic]

    def follow(self, *_: object, **__: object) -> None:  # type: ignore[override]
        raise AssertionError("nothing is read to find a topic")

    async def graph(self) -> GraphSnapshot:
        def ends(kind: str) -> Sequence[Endpoint]:
            return [Endpoint("/node", kind, "", "", QoS())]

        return GraphSnapshot({name: TopicEndpoints(name, ends(kind), ()) for name, kind in self._topics.items()})


async def test_the_only_one_is_taken_and_said() -> None:
    topic, said = await only_topic(Listed(floor=OCCUPANCY_GRID, points=POINT_CLOUD), "", OCCUPANCY_GRID)
    assert topic == "/floor" and "/floor is the only topic of type nav_msgs/msg/OccupancyGrid" in said


async def test_a_name_is_never_second_guessed() -> None:
    assert await only_topic(Listed(floor=OCCUPANCY_GRID), "/other", OCCUPANCY_GRID) == ("/other", "")


async def test_of_a_map_and_costmaps_the_map_is_taken_and_the_others_are_named() -> None:
    both = Listed(map=OCCUPANCY_GRID, local_costmap__costmap=OCCUPANCY_GRID, global_costmap__costmap=OCCUPANCY_GRID)
    topic, said = await only_topic(both, "", OCCUPANCY_GRID)
    assert topic == "/map" and "/global_costmap/costmap, /local_costmap/costmap" in said


@pytest.mark.parametrize("names", [("front", "rear"), ("a_costmap", "b_costmap")])
async def test_of_several_none_is_guessed(names: Sequence[str]) -> None:
    with pytest.raises(BadInput, match=f"/{names[0]}, /{names[1]}.*") as refused:
        await only_topic(Listed(**dict.fromkeys(names, POINT_CLOUD)), "", POINT_CLOUD)
    assert "topic_name" in refused.value.hint


async def test_where_there_is_none_that_is_said() -> None:
    with pytest.raises(NotFound, match="No topic of type sensor_msgs/msg/PointCloud2 has a publisher"):
        await only_topic(Listed(floor=OCCUPANCY_GRID), "", POINT_CLOUD)
