from __future__ import annotations

import pytest

from ros2_mcp.model.address import LOCAL, of_command, parse_address
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings


def test_an_address_for_ssh_has_user_host_port_and_container() -> None:
    found = parse_address("lab=ssh://ubuntu@lab.local:2222/?container=ros&domain_id=7")
    assert (found.kind, found.name, found.user, found.host, found.port) == ("ssh", "lab", "ubuntu", "lab.local", 2222)
    assert (found.container, found.domain_id, found.is_remote) == ("ros", 7, True)
    assert found.place == "ssh://ubuntu@lab.local:2222?container=ros"
    assert parse_address(found.written) == found


def test_what_an_address_leaves_out_is_left_to_ssh() -> None:
    found = parse_address("ssh://robot")
    assert (found.name, found.user, found.host, found.port, found.container) == ("", "", "robot", 0, "")


def test_an_address_of_ipv6_stands_in_brackets() -> None:
    found = parse_address("ssh://me@[fe80::1%eth0]:22")
    assert (found.host, found.port) == ("fe80::1%eth0", 22)
    assert parse_address("ssh://me@[::1]").host == "::1"


def test_a_container_and_this_machine_have_addresses() -> None:
    assert (parse_address("docker://ros_dev").kind, parse_address("docker://ros_dev").container) == (
        "docker",
        "ros_dev",
    )
    assert parse_address("local") == LOCAL
    assert parse_address("yard=local?domain_id=7").domain_id == 7
    assert not parse_address("local").is_remote


def test_a_robot_is_the_same_whoever_logs_in_and_whatever_it_is_called() -> None:
    same = {parse_address(text).identity for text in ("ssh://me@Lab", "lab=ssh://lab", "ssh://you@lab:22/?domain_id=3")}
    assert same == {"ssh-lab"}
    others = ("ssh://lab:23", "ssh://lab?container=a", "docker://lab", "local")
    assert len({parse_address(text).identity for text in others} | same) == 5
    assert of_command(["kubectl", "exec", "-i", "pod", "--"]).identity == "command-kubectl exec -i pod --"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("me@robot", "Did you mean ssh://me@robot?"),
        ("robot.local", "Did you mean ssh://robot.local?"),
        ("ssh://me:secret@robot", "must not contain a password"),
        ("ssh://-oProxyCommand=x", "does not begin with a dash"),
        ("ssh://-x@robot", "does not begin with a dash"),
        ("ssh://a;b", "The host of"),
        ("ssh://", "The host of"),
        ("ssh://@robot", "The user of"),
        ("ssh://robot:0", "Give a port from 1"),
        ("ssh://robot:70000", "Give a port from 1"),
        ("ssh://robot?contaner=a", "are: container, domain_id"),
        ("ssh://robot?container=--privileged", "The container of"),
        ("ssh://robot?container=a&container=b", "occurs twice in"),
        ("docker://", "The container of"),
        ("docker://a?container=b", "are: domain_id"),
        ("local?domain_id=233", "From 0 to 232"),
        ("https://robot", "is not supported"),
        ("a b", "not the address of a robot"),
    ],
)
def test_what_is_no_address_is_refused_with_what_would_be(text: str, told: str) -> None:
    with pytest.raises(BadInput) as refused:
        parse_address(text)
    assert told in str(refused.value)
    assert "secret" not in str(refused.value)


def test_variables_of_this_machine_do_not_hold_for_a_robot_elsewhere() -> None:
    env = {"ROS_DOMAIN_ID": "5", "RMW_IMPLEMENTATION": "rmw_x", "ROS2_MCP_DISTRO": "humble"}
    there = Settings.from_environment({**env, "ROS2_MCP_ROBOT": "ssh://robot"})
    assert (there.domain_id, there.rmw, there.distro) == (None, None, "humble")
    assert Settings.from_environment({**env, "ROS2_MCP_ROBOT": "local"}).domain_id == 5
    assert Settings.from_environment({**env, "ROS2_MCP_ROBOT": "ssh://robot?domain_id=7"}).domain_id == 7
    by_option = Settings.from_environment({**env, "ROS2_MCP_ROBOT": "ssh://robot"}, domain_id=9)
    assert by_option.domain_id == 9


def test_several_robots_have_names_that_differ() -> None:
    made = Settings.from_environment({"ROS2_MCP_ROBOT": "lab=ssh://a yard=ssh://b"})
    assert [robot.name for robot in made.robots] == ["lab", "yard"]
    for text in ("ssh://a ssh://b", "a=ssh://a a=ssh://b"):
        with pytest.raises(BadInput, match="NAME=ADDRESS with names that differ"):
            Settings.from_environment({"ROS2_MCP_ROBOT": text})


def test_a_command_stands_for_an_address_but_not_beside_one() -> None:
    made = Settings.from_environment({"ROS2_MCP_ROBOT_COMMAND": "kubectl exec -i 'my pod' --"})
    assert made.robot.command == ("kubectl", "exec", "-i", "my pod", "--")
    with pytest.raises(BadInput, match="Both --robot and --robot-command"):
        Settings.from_environment({"ROS2_MCP_ROBOT_COMMAND": "x", "ROS2_MCP_ROBOT": "ssh://a"})
