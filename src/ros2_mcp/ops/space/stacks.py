"""Which well-known stacks run on a robot: Nav2, MoveIt, ros2_control and such, by their nodes, types and services."""

from __future__ import annotations

from ros2_mcp.ops.sources.source import GraphSnapshot


def stacks_of(graph: GraphSnapshot) -> list[str]:
    """Their names, in a fixed order."""
    nodes = {name.rpartition("/")[2] for name in graph.nodes or ()}
    types = {kind for one in graph.topics.values() for kind in one.types}
    services = {name.rpartition("/")[2] for name in graph.services or ()}
    return [
        name
        for name, is_there in (
            ("Nav2", "bt_navigator" in nodes or any(kind.startswith("nav2_msgs/action/Navigate") for kind in types)),
            ("MoveIt", "move_group" in nodes or any(kind.startswith("moveit_msgs/action/") for kind in types)),
            ("ros2_control", "controller_manager" in nodes or "list_controllers" in services),
            ("MAVROS", "mavros_msgs/msg/State" in types),
            ("slam_toolbox", "slam_toolbox" in nodes),
            ("amcl", "amcl" in nodes),
        )
        if is_there
    ]
