"""Names of types as people write them, and names that are not there, against a graph made for the purpose."""

from __future__ import annotations

from typing import Any, cast

import pytest

from ros2_mcp.link.client import Bridge, Reply
from ros2_mcp.model.errors import BadInput, BadName, NotFound, RobotError, TypeConflict, UnknownInterface
from ros2_mcp.model.graph import TopicEndpoints
from ros2_mcp.model.qos import Endpoint, QoS
from ros2_mcp.ops.nodes.info import node_info
from ros2_mcp.ops.services.call import call
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot

INSTALLED = [
    "example_interfaces/msg/String",
    "geometry_msgs/msg/Twist",
    "iam_msgs/srv/IssueToken",
    "nav2_msgs/action/Spin",
    "std_msgs/msg/Empty",
    "std_msgs/msg/String",
    "std_srvs/srv/Empty",
    "std_srvs/srv/SetBool",
]


class SmallBridge:
    """Of a settled graph: the topic /scan, the service /set_lamp, and one node, if it `has_robot`."""

    hello = None
    nodes = frozenset[str]()
    is_closed = False
    is_remote = False

    def __init__(self) -> None:
        self.has_robot = True

    async def request(self, op: str, *_: bytes, **arguments: Any) -> Reply:
        return Reply(getattr(self, f"_{op}")(**arguments), b"")

    def _interfaces(self, **_: Any) -> Any:
        return {"interfaces": INSTALLED}

    def _topics(self, **_: Any) -> Any:
        topics = [("/scan", ["sensor_msgs/msg/LaserScan"], 1, 0), ("/spin/_action/status", ["a/msg/B"], 1, 0)]
        return {"topics": topics if self.has_robot else [], "settled": True}

    def _services(self, **_: Any) -> Any:
        services = [("/set_lamp", ["std_srvs/srv/SetBool"]), ("/spin/_action/send_goal", ["n/action/Spin_SendGoal"])]
        return {"services": services if self.has_robot else [], "settled": True}

    def _nodes(self, **_: Any) -> Any:
        return {"nodes": [("lidar", "/")] if self.has_robot else [], "settled": True}

    def _node(self, **_: Any) -> Any:
        return {"publishers": [("/scan", ["s/msg/S"])], "subscribers": [], "servers": [], "clients": []}

    def _endpoints(self, **_: Any) -> Any:
        return {"publishers": [], "subscribers": [], "settled": True}

    def _definitions(self, **_: Any) -> Any:
        return {"definitions": {"std_srvs/srv/SetBool": {"format": "srv", "text": "bool data\n---\n"}}, "missing": []}

    _wait_endpoints = _endpoints


@pytest.fixture
def bridge() -> SmallBridge:
    return SmallBridge()


@pytest.fixture
def robot(bridge: SmallBridge) -> Robot:
    return Robot(cast(Bridge, bridge))


@pytest.mark.parametrize(
    ("requested", "kind", "full"),
    [
        ("Twist", "msg", "geometry_msgs/msg/Twist"),
        ("IssueToken", "", "iam_msgs/srv/IssueToken"),
        ("Spin", "action", "nav2_msgs/action/Spin"),
        ("Empty", "srv", "std_srvs/srv/Empty"),
        ("std_srvs/SetBool", "", "std_srvs/srv/SetBool"),
        ("std_srvs/SetBool", "srv", "std_srvs/srv/SetBool"),
        ("other_msgs/msg/Thing", "msg", "other_msgs/msg/Thing"),
    ],
)
async def test_a_type_is_found_by_its_name_alone(robot: Robot, requested: str, kind: str, full: str) -> None:
    assert await robot.types.full_name(requested, kind) == full


@pytest.mark.parametrize(
    ("requested", "kind", "error", "words"),
    [
        ("String", "msg", TypeConflict, "String may be example_interfaces/msg/String or std_msgs/msg/String."),
        ("Empty", "", TypeConflict, "Empty may be std_msgs/msg/Empty or std_srvs/srv/Empty."),
        ("Twits", "msg", UnknownInterface, "Did you mean geometry_msgs/msg/Twist?"),
        ("IssueToken", "msg", UnknownInterface, "There is iam_msgs/srv/IssueToken, which is no msg."),
        ("std_srvs/SetBol", "", UnknownInterface, "Did you mean std_srvs/srv/SetBool?"),
        ("std_srvs/srv/SetBool", "msg", BadName, "is a srv type, but a msg type is needed here."),
        ("no type", "msg", BadName, "is not the name of a type."),
    ],
)
async def test_a_type_that_is_not_found_is_told_with_what_may_be_meant(
    robot: Robot, requested: str, kind: str, error: type[RobotError], words: str
) -> None:
    with pytest.raises(error, match=words.replace("?", r"\?")):
        await robot.types.full_name(requested, kind)


async def test_of_several_types_of_that_name_the_one_in_use_is_meant(robot: Robot) -> None:
    assert await robot.types.full_name("String", "msg", ["std_msgs/msg/String"]) == "std_msgs/msg/String"


async def test_of_a_topic_with_several_types_it_is_told_who_has_which_and_what_takes_a_type(robot: Robot) -> None:
    ends = [Endpoint(node, f"a/msg/{kind}", "", "", QoS()) for node, kind in (("/one", "One"), ("/two", "Two"))]
    with pytest.raises(TypeConflict) as told:
        await robot.types.topic(TopicEndpoints("/both", ends, []))
    assert told.value.message == "/both has 2 types: a/msg/One, a/msg/Two."
    assert told.value.hint.startswith("/one publishes a/msg/One, /two publishes a/msg/Two. ")
    assert "ros2_topic_subscribe takes msg_type" in told.value.hint


async def test_a_misspelt_topic_is_told_at_once_where_no_time_to_wait_is_given(robot: Robot) -> None:
    with pytest.raises(NotFound, match=r"no topic /scna.*Did you mean /scan\?"):
        async with Live(robot, 600, waits=False).follow("/scna", "LaserScan"):
            pass


async def test_a_time_to_wait_is_waited_and_what_is_near_is_told_first(robot: Robot) -> None:
    told: list[str] = []

    async def report(_done: float, _whole: float, line: str) -> None:
        told.append(line)

    source = Live(robot, waits=False, report=report).lasting(0.1, recorded_s=0.1)
    with pytest.raises(NotFound, match="no topic /scna"):
        async with source.follow("/scna"):
            pass
    assert told == ["Waiting for the topic /scna. Did you mean /scan?"]


async def test_a_misspelt_service_is_told_at_once_though_its_type_is_given(robot: Robot) -> None:
    with pytest.raises(NotFound, match=r"no service /set_lmap.*Did you mean /set_lamp\?"):
        await call(robot, robot.session(), "/set_lmap", "SetBool", {"data": True}, timeout_s=600, waits=False)


async def test_a_call_is_forced_only_with_fields_that_were_given(robot: Robot) -> None:
    with pytest.raises(BadInput, match=r"The request needs fields: data\."):
        await call(robot, robot.session(), "/set_lamp", "SetBool", None, force_call=True, timeout_s=0.1)


async def test_a_misspelt_action_is_told_with_the_nearest(robot: Robot) -> None:
    with pytest.raises(NotFound, match=r"no action /spn.*Did you mean /spin\?"):
        await robot.types.action("/spn")


async def test_hidden_names_are_not_suggested(robot: Robot) -> None:
    assert str(await robot.graph.no_such_topic("/spin/action/status")).endswith("ros2_topic_list shows what is there.")
    assert str(await robot.graph.no_such_topic("/spin/_action/statsu")).endswith("mean /spin/_action/status?")


async def test_where_there_is_no_robot_a_name_that_is_not_there_is_no_misspelling(
    robot: Robot, bridge: SmallBridge
) -> None:
    bridge.has_robot = False
    assert "No robot is seen in this domain." in str(await robot.graph.no_such_topic("/scan"))
    assert "No robot is seen in this domain." in str(await robot.types.no_such_service("/set_lamp"))


async def test_a_robot_elsewhere_that_is_not_seen_is_looked_for_there_and_in_other_domains(
    robot: Robot, bridge: SmallBridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge.has_robot = False
    assert "reachable from here" in await robot.graph.absence()
    monkeypatch.setattr(SmallBridge, "is_remote", True)
    told = await robot.graph.absence()
    assert "running there" in told
    assert "--domain-id N" in told and "?domain_id=N" in told
    assert " here" not in told


async def test_a_node_of_which_nothing_is_discovered_yet_is_asked_for_again(
    bridge: SmallBridge, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing: Any = {"publishers": [], "subscribers": [], "servers": [], "clients": []}
    answers = [nothing, nothing]
    whole: Any = {**nothing, "publishers": [("/scan", ["s/msg/S"])]}

    def late(**_: Any) -> Any:
        return answers.pop() if answers else whole

    def never(**_: Any) -> Any:
        return nothing

    monkeypatch.setattr(bridge, "_node", late)
    found = await node_info(robot, "/lidar")
    assert (found.settled, len(found.publishes)) == (True, 1)

    monkeypatch.setattr(bridge, "_node", never)
    found = await node_info(robot, "/lidar")
    assert not found.settled and "Discovery had not settled" in found.summary()
