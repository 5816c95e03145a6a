"""The tour's chapter with the rover and all of Nav2: a goal, and why another goal fails."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from ros2_mcp.commands.transcript import Tour

_BUILT_S = 90
"""The longest wait in s for Nav2's interfaces, which are built once, while the robot runs."""


async def go(tour: Tour) -> None:
    """Drive through the doorway, and explain why a goal in a wall fails."""
    tour.say("Go with Nav2: planner, controller, smoother, collision monitor, base.")
    for _ in range(_BUILT_S):
        actions = {entry["name"] for entry in (await tour.call("ros2_list_actions"))["actions"]}
        if "/navigate_to_pose" in actions:
            break
        await asyncio.sleep(1.0)
    else:
        tour.say("Navigation is left out: its interfaces could not be built here.")
        return
    done = await tour.call("ros2_navigate", to=[{"x": 1.0, "y": 0.5}])
    tour.verify(f"the goal was reached in {done['duration_s']} s", done["outcome"] == "reached")
    why = (await tour.call("ros2_navigate", to=[{"x": 2.5, "y": -1.0}]))["explanation"]
    tour.show(f"a goal in a wall: {why['cause']} {' '.join(why['helps'])}")
    tour.verify("the failure is explained", "is occupied" in why["cause"])


NAV2: Sequence[Callable[[Tour], Awaitable[None]]] = (go,)
