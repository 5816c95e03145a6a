"""What a server that has just started says of the graph: nothing is called settled that is not."""

from __future__ import annotations

import time

import pytest

from support.agent import FULL

PROCESSES = 4


pytestmark = pytest.mark.full


@pytest.mark.promise(
    "ros2_topic_list", "List the topics of the robot with their types and the number of publishers and subscribers"
)
async def test_a_first_listing_that_is_called_settled_holds_the_topics_of_every_process(start_agent, peer) -> None:
    topics = {f"/part{number}" for number in range(PROCESSES)}
    for topic in topics:
        peer("repeat", topic, "std_msgs/msg/String", 5)
    listings = []

    for _ in range(20 if FULL else 2):
        async with start_agent() as agent:
            listings.append(await agent.call("ros2_topic_list", pattern="/part*"))
    found = [{topic["topic_name"] for topic in listing["topics"]} for listing in listings if listing["settled"]]
    assert found
    assert all(names == topics for names in found)


async def test_where_there_is_nobody_the_first_listing_says_so_without_waiting_for_announcements(start_agent) -> None:
    async with start_agent() as agent:
        begun = time.monotonic()
        listing = await agent.call("ros2_topic_list")
        assert listing["settled"]
        assert time.monotonic() - begun < 2.5
