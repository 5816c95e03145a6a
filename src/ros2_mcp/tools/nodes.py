"""Tools for nodes, their parameters and their lifecycle."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from ros2_mcp.ops.nodes import info, lifecycle, parameters
from ros2_mcp.ops.nodes.list import NodeList, list_nodes
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import Flag, Hidden, Limit, Pattern
from ros2_mcp.tools.declare import tool

PLACE = 100
"""Place of the tools for parameters and lifecycle; the list of nodes has a place near the top."""

NodeName = Annotated[str, Field(description="Full name, such as /base_controller.")]
NodeNames = Annotated[list[str] | None, Field(description="Full names of nodes. Default: every node.")]


@tool(
    title="List nodes", risk="read", place=11, program="nodes", finds="which nodes are running, list nodes, processes"
)
async def ros2_node_list(
    robot: Robot, pattern: Pattern = "", include_hidden: Hidden = False, limit: Limit = 200
) -> NodeList:
    """List the nodes of the robot by full name, and names that several nodes share."""
    return await list_nodes(robot, pattern, include_hidden, limit)


@tool(
    title="Node details",
    risk="read",
    group="lifecycle",
    by_default=False,
    finds="what does a node do, its topics, services, lifecycle",
)
async def ros2_node_info(robot: Robot, node_name: NodeName) -> info.NodeInfo:
    """Show what a node publishes, subscribes to, serves and calls, its lifecycle state and number of parameters."""
    return await info.node_info(robot, node_name)


@tool(title="List parameters", risk="read", group="parameters", finds="settings, configuration, parameters of nodes")
async def ros2_parameter_list(
    robot: Robot, node_names: NodeNames = None, pattern: Pattern = "", limit: Limit = 100
) -> parameters.ParameterList:
    """List parameters with value, type, description, range and whether they are read-only; several nodes at once."""
    return await parameters.describe(robot, node_names or (), pattern, limit)


@tool(
    title="Read parameters",
    risk="read",
    group="parameters",
    by_default=False,
    program="parameters",
    finds="read all parameter values of a node",
)
async def ros2_parameter_get(
    robot: Robot,
    node_name: NodeName,
    names: Annotated[list[str] | None, Field(description="Names of parameters. Default: all.")] = None,
    whole: Annotated[Flag, Field(description="Also return long values, in full.")] = False,
) -> parameters.Dump:
    """Read parameters of a node as name → value, in the form in which they can be set."""
    return await parameters.dump(robot, node_name, names, whole=whole)


@tool(
    title="Set parameters",
    risk="actuate",
    does={"set": ()},
    group="parameters",
    program="set_parameter",
    finds="change a setting, configure, tune, parameter",
)
async def ros2_parameter_set(
    robot: Robot,
    session: Session,
    node_name: NodeName,
    values: Annotated[dict[str, Any], Field(description='Name → value, such as {"max_speed": 0.5}.')],
    atomic: Annotated[Flag, Field(description="Set all of them or none.")] = False,
) -> parameters.SetResult:
    """Set parameters of a node. Values are checked against type and range first, and read back afterwards."""
    return await parameters.set_values(robot, session, node_name, values, atomic=atomic)


@tool(
    title="Lifecycle states",
    risk="read",
    group="lifecycle",
    by_default=False,
    finds="is a node active, inactive, unconfigured",
)
async def ros2_lifecycle_state(robot: Robot, node_names: NodeNames = None) -> lifecycle.LifecycleStates:
    """Show the state of lifecycle nodes and the transitions possible now."""
    return await lifecycle.states(robot, node_names or ())


@tool(
    title="Change a lifecycle state",
    risk="actuate",
    does={"transition": ()},
    group="lifecycle",
    by_default=False,
    finds="activate, deactivate, configure, start a lifecycle node",
)
async def ros2_lifecycle_change(
    robot: Robot,
    session: Session,
    node_name: NodeName,
    transition: Annotated[str, Field(description="Transition that is possible now, such as configure or activate.")],
) -> lifecycle.Transition:
    """Trigger a transition of a lifecycle node by name."""
    return await lifecycle.change(robot, session, node_name, transition)
