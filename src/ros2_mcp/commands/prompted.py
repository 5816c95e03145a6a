"""Follows a prompt as a model would: its calls in order, with numbers from earlier answers."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PROMPTS = Path(__file__).resolve().parents[2] / "ros2_mcp_demo" / "prompts"
"""The prompts that come with the simulated robots, for `--prompts`."""
_CALL = re.compile(r"\bCall (ros2_\w+) with\s+(?=\{)")
_METRES_PER_DEGREE = 111_320
"""As in the text of the drone mission's prompt."""

Call = Callable[[str, Mapping[str, Any]], Awaitable[Mapping[str, Any]]]
"""Calls a tool by its name with arguments, and returns its structured content."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The result of following a prompt: the answers in order, each with its tool, and which step failed, in words
    ("" if none).
    """

    answers: list[tuple[str, Mapping[str, Any]]]
    failed: str = ""


async def follow_mission(call: Call, text: str, *, dest_x: float, dest_y: float) -> Followed:
    """Carry out the steps of the drone's mission, until one fails or all are done. `dest_x` (east) and `dest_y` (north)
    are in m from home.
    """
    answers: list[tuple[str, Mapping[str, Any]]] = []
    numbers: dict[str, float] = {}
    for found in _CALL.finditer(text):
        written = text[found.end() :]
        for word, number in numbers.items():
            written = written.replace(word, repr(number))
        arguments: dict[str, Any] = json.JSONDecoder().raw_decode(written)[0]
        answer = await call(found[1], arguments)
        answers.append((found[1], answer))
        if problem := _problem(arguments, answer):
            return Followed(answers, f"{found[1]} {json.dumps(arguments)[:120]}: {problem}")
        if str(arguments.get("topic_name", "")).endswith("/home_position/home"):
            numbers = _places(answer["message"]["geo"], dest_x, dest_y)
    return Followed(answers)


def _places(home: Mapping[str, float], dest_x: float, dest_y: float) -> dict[str, float]:
    latitude, longitude = home["latitude"], home["longitude"]
    east = dest_x / (_METRES_PER_DEGREE * math.cos(math.radians(latitude)))
    return {
        "HOME_LAT": latitude,
        "HOME_LON": longitude,
        "DEST_LAT": latitude + dest_y / _METRES_PER_DEGREE,
        "DEST_LON": longitude + east,
    }


def _problem(arguments: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    """Return why the prompt says to stop here; "" if it says to continue."""
    if not answer.get("met", True):
        return f"not met; the last was {answer.get('values')}"
    result: Mapping[str, Any] = answer.get("result") or {}
    if not (result.get("success", True) and result.get("mode_sent", True)):
        return str(answer.get("note", "refused"))
    pushed = arguments.get("fields", {}).get("waypoints", ())
    if pushed and result.get("wp_transfered") != len(pushed):
        return f"{result.get('wp_transfered')} of {len(pushed)} waypoints were taken"
    messages: Sequence[Mapping[str, Any]] = answer.get("messages") or ({},)
    return "it is armed already" if messages[-1].get("armed") else ""
