"""The prompt on a robot that does not navigate: from its cause to its remedy, and to a goal that is reached."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

from ros2_mcp.model.arguments import Argument
from ros2_mcp.prompts.prompt import Message, Prompt, step

_CHECK = "ros2_nav_check"
_REMEDIES = {
    "ros2_nav_recover": "servers that are down, an old costmap, too near to something: ros2_nav_recover",
    "ros2_nav_localize": "a wrong pose: ros2_nav_localize",
    "ros2_parameter_set": "a parameter: ros2_parameter_set",
}
"""Tool → what it is a remedy for, and its name."""


def navigation_prompt(missing: Collection[str] = ()) -> Prompt:
    """Return the prompt for a server that does not offer the tools in `missing`."""

    async def write(values: Mapping[str, Any]) -> Sequence[Message]:
        return [Message("\n".join(_lines(_place(values["to"]), missing)))]

    return Prompt(
        "base.ros2-navigation-check",
        "Why does it not navigate?",
        "Find out why a robot with Nav2 does not go, carry out the remedy, and see that it goes.",
        (
            Argument(
                "to", "Where it should go: a named place, or x and y in m such as 2.0, 1.2; empty: anywhere", default=""
            ),
        ),
        write,
    )


def _place(given: str) -> Mapping[str, Any] | None:
    """Return the place as the tools take it; None if none is given."""
    if not given.strip():
        return None
    with suppress(ValueError):
        x, y = map(float, given.split(","))
        return {"x": x, "y": y}
    return {"place": given.strip()}


def _lines(to: Mapping[str, Any] | None, missing: Collection[str]) -> list[str]:
    is_whole = _CHECK not in missing
    first = step(1, _CHECK, to=to) if is_whole else step(1, "ros2_health_check")
    remedies = [remedy for tool, remedy in _REMEDIES.items() if tool not in missing]
    lines = [
        "Find out why the robot does not navigate, and get it going.",
        first,
        "Each finding has a cause, its proof and a remedy. Begin with the first one.",
    ]
    if remedies:
        lines.append(f"2. Carry out its remedy ({'; '.join(remedies)}). Repeat step 1 until it is not found any more.")
    lines.append(
        "What no tool can do (a pressed emergency stop, cables, files): say exactly what to do, and end there. Motors "
        "that a service switches on: only if the user lets you."
    )
    if is_whole and "ros2_nav_probe" not in missing:
        lines.append(
            "3. If nothing is found, ask the user whether the robot may move 0.2 m and 30°; then call ros2_nav_probe."
        )
    if "ros2_navigate" not in missing:
        dock = ", or ros2_nav_dock to a dock" if "ros2_nav_dock" not in missing else ""
        lines.append(f"4. To make it go, if the user wants that: ros2_navigate{dock}. It says what holds the robot up.")
    if not is_whole:
        lines.append("The option --tools default,navigation of this server gives a check that looks at more: say so.")
    lines.append(
        "Then report: the cause with its proof, what you changed, and by which measurement you know that it helped."
    )
    return lines
