"""The name of Nav2's action of a type: the given name, or the name of the only action."""

from __future__ import annotations

from ros2_mcp.model import names
from ros2_mcp.model.errors import TypeConflict
from ros2_mcp.model.text import listed
from ros2_mcp.robot import Robot


async def action_of(robot: Robot, kind: str, given: str = "") -> str:
    """Return the name of an action of this type: the given name, or the name of the only action.

    Raises:
        NotFound: if there is none; names the others, or says that there is no robot.
        TypeConflict: if the given one has another type, or there are several and none is given.
    """
    actions = await robot.types.actions()
    if given:
        name = names.absolute(given, "action")
        await robot.types.action(name, kind)
        return name
    found = sorted(name for name, types in actions.items() if kind in types)
    if len(found) == 1:
        return found[0]
    if found:
        raise TypeConflict(f"Several actions have the type {kind}: {listed(found, 5)}.", "Give action_name.")
    others = f" Other actions: {listed(sorted(actions), 5)}; ros2_send_action_goal sends them goals." if actions else ""
    raise await robot.graph.missing(
        f"There is no action of type {kind}: no server of that type is seen. Nav2 is not running, or not configured."
        f"{others}",
        "ros2_lifecycle_state shows whether its servers are configured.",
    )
