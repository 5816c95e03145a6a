from __future__ import annotations

import pytest

from ros2_mcp.model import names
from ros2_mcp.model.errors import BadName


@pytest.mark.parametrize(
    ("given", "full"),
    [
        ("/scan", "/scan"),
        ("scan", "/scan"),
        ("robot1/scan", "/robot1/scan"),
        ("  /scan ", "/scan"),
        ("/_x/y2", "/_x/y2"),
    ],
)
def test_a_name_becomes_fully_qualified(given: str, full: str) -> None:
    assert names.absolute(given) == full


@pytest.mark.parametrize("given", ["", "/", "/scan/", "//scan", "/2d", "/a b", "/é", "/a-b", "/scan\n/x", "/scan;rm"])
def test_a_name_that_ros_does_not_allow_is_refused(given: str) -> None:
    with pytest.raises(BadName, match="not a valid topic name"):
        names.absolute(given)


def test_a_name_that_the_middleware_cannot_carry_is_refused_with_the_longest() -> None:
    assert names.absolute("/" + "a" * 246)
    with pytest.raises(BadName, match="at most 247"):
        names.absolute("/" + "a" * 247)


def test_a_private_name_is_refused_with_the_form_that_would_be_right() -> None:
    with pytest.raises(BadName, match="/node_name/pose"):
        names.absolute("~/pose")


@pytest.mark.parametrize("full", ["/driver", "/arm/driver", "/a/b/c"])
def test_a_node_name_is_parted_and_joined_without_loss(full: str) -> None:
    assert names.full_node_name(*names.node_name(full)) == full


@pytest.mark.parametrize(
    "given",
    ["std_msgs/msg/String", "std_msgs/String", "std_msgs.msg.String", "std_msgs::msg::String", " std_msgs/String"],
)
def test_every_spelling_of_a_type_becomes_the_full_one(given: str) -> None:
    assert names.interface_type(given, "msg") == "std_msgs/msg/String"


@pytest.mark.parametrize("given", ["String", "std_msgs/", "std_msgs/msg/a/b", "Std/msg/String", "std_msgs/foo/String"])
def test_what_is_no_type_is_refused_with_the_form_that_would_be_right(given: str) -> None:
    with pytest.raises(BadName, match="package/srv/Name"):
        names.interface_type(given, "srv")


def test_a_type_of_another_kind_is_refused() -> None:
    with pytest.raises(BadName, match="is a srv type, but a msg type"):
        names.interface_type("std_srvs/srv/SetBool", "msg")


@pytest.mark.parametrize(
    ("derived", "defining"),
    [
        ("a/action/Go_SendGoal_Request", "a/action/Go"),
        ("a/action/Go_FeedbackMessage", "a/action/Go"),
        ("a/action/Go", "a/action/Go"),
        ("a/srv/Do_Response", "a/srv/Do"),
        ("a/srv/My_Do_Request", "a/srv/My_Do"),
        ("a/msg/Last_Result", "a/msg/Last_Result"),
    ],
)
def test_a_derived_type_leads_to_the_file_that_defines_it(derived: str, defining: str) -> None:
    assert names.defining_type(derived) == defining


@pytest.mark.parametrize(
    ("pattern", "chosen"),
    [
        ("", ["/scan", "/camera/image_raw", "/camera/info"]),
        ("CAM", ["/camera/image_raw", "/camera/info"]),
        ("/camera/*", ["/camera/image_raw", "/camera/info"]),
        ("/sca?", ["/scan"]),
        ("camera/*", []),
        ("nothing", []),
    ],
)
def test_a_pattern_is_a_glob_or_any_part_of_a_name(pattern: str, chosen: list[str]) -> None:
    assert names.matching(["/scan", "/camera/image_raw", "/camera/info"], pattern) == chosen


@pytest.mark.parametrize(
    ("pattern", "chosen"),
    [("laserscan", ["/front"]), ("std_srvs/*", ["/reset"]), ("*/SetBool", ["/reset"]), ("/reset", ["/reset"])],
)
def test_a_pattern_matches_types_too(pattern: str, chosen: list[str]) -> None:
    types = {"/front": ["sensor_msgs/msg/LaserScan"], "/reset": ["std_srvs/srv/Empty", "std_srvs/srv/SetBool"]}
    assert names.matching(sorted(types), pattern, types.__getitem__) == chosen


def test_the_nearest_name_is_found_whatever_its_case() -> None:
    assert names.nearest("/SCANN", ["/odom", "/scan"]) == "/scan"
    assert names.nearest("/velocity", ["/odom", "/scan"]) == ""


def test_a_hint_names_the_nearest_or_says_where_to_look() -> None:
    assert names.did_you_mean("/odm", ["/odom"], "Look.") == "Did you mean /odom?"
    assert names.did_you_mean("/zzz", ["/odom"], "Look.") == "Look."


@pytest.mark.parametrize(("name", "hidden"), [("/_x", True), ("/a/_action/feedback", True), ("/a_b", False)])
def test_a_name_with_a_part_that_starts_with_an_underscore_is_hidden(name: str, hidden: bool) -> None:
    assert names.is_hidden(name) is hidden
