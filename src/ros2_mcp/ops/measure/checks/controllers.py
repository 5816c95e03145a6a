"""Inactive controllers whose joints no other controller commands, and inactive hardware components."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ros2_mcp.model.text import named
from ros2_mcp.ops.measure.checks.check import FIRST, Check
from ros2_mcp.ops.measure.evidence import Evidence, Ros2Control
from ros2_mcp.ops.measure.findings import Finding


def _find(evidence: Evidence) -> Iterator[Finding]:
    for node, control in (evidence.ros2_control or {}).items():
        yield from _idle_controllers(node, control)
        yield from _idle_hardware(node, control)


def _idle_controllers(node: str, control: Ros2Control) -> Iterator[Finding]:
    """Report inactive controllers, except where active controllers claim all of their command interfaces."""
    active = [one for one in control.controllers if one["state"] == "active"]
    claimed = {str(name) for one in active for name in one.get("claimed_interfaces", ())}
    for one in control.controllers:
        needed = [str(name) for name in one.get("required_command_interfaces", ())]
        if one["state"] == "active" or (needed and claimed.issuperset(needed)):
            continue
        name, kind = _full(node, one), str(one.get("type", "")).rpartition("/")[2]
        what = f" ({named(kind)})" if kind else ""
        problem = f"The controller{what} is {named(str(one['state']))}: it does nothing."
        advice = f"Activate it, as with the service {node}/switch_controller, if it is needed."
        yield Finding("warning", name, problem, advice, name)


def _idle_hardware(node: str, control: Ros2Control) -> Iterator[Finding]:
    active = [one for one in control.controllers if one["state"] == "active"]
    for component in control.hardware or ():
        state = str(component["state"]["label"] or component["state"]["id"])
        if state == "active":
            continue
        interfaces = {
            str(one["name"]) for side in ("command_interfaces", "state_interfaces") for one in component.get(side, ())
        }
        above = [_full(node, one) for one in active if interfaces & _used(one)]
        name = f"{node.rpartition('/')[0]}/{component['name']}"
        below = f", below the active {', '.join(above)}, whose commands have no effect" if above else ""
        problem = f"The hardware component {named(str(component['name']))} is {named(state)}{below}."
        advice = f"Check its driver and log; {node}/set_hardware_component_state activates it."
        yield Finding("warning", above[0] if above else name, problem, advice, above[0] if above else "")


def _used(controller: Mapping[str, Any]) -> set[str]:
    sides = ("claimed_interfaces", "required_command_interfaces", "required_state_interfaces")
    return {str(name) for side in sides for name in controller.get(side, ())}


def _full(node: str, controller: Mapping[str, Any]) -> str:
    return f"{node.rpartition('/')[0]}/{controller['name']}"


CHECK = Check(("ros2_control",), _find, place=FIRST)
