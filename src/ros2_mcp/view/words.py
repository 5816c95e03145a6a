"""What a page shows, in words for the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.view.look import Content

_MOST_NAMED = 5


def in_words(panel: str, content: Content | None) -> str:
    """One line about one panel; `content` is what it shows, if it shows anything yet."""
    if content is None:
        return f"{panel}: nothing yet"
    told = _WORDS.get(panel, _topic)(content)
    why = str(content.get("why") or "")
    return f"{panel}: {'; '.join(filter(None, (told, why))) or 'nothing'}"


def _map(content: Content) -> str:
    parts: list[str] = []
    if grid := content.get("grid"):
        parts.append(named(str(grid["name"])))
    if at := content.get("robot"):
        where = f"({at['x']:.2f}, {at['y']:.2f}) m in {named(str(content.get('frame')))}"
        parts.append(f"the robot at {where}, heading {round(math.degrees(at['yaw']))}°")
    elif content.get("frame"):
        parts.append("nobody says where the robot is")
    for kind in ("goals", "places", "paths"):
        if names := [str(one["name"]) for one in content.get(kind) or ()]:
            parts.append(f"{kind} {listed(names, _MOST_NAMED)}")
    return ", ".join(parts)


def _topic(content: Content) -> str:
    if not content.get("topic"):
        return ""
    size = f", {content['width']} × {content['height']}" if content.get("width") else ""
    rate = f", {content['rate_hz']:.3g} Hz" if content.get("rate_hz") else ""
    return f"{named(str(content['topic']))}{size}{rate}"


def _agent(content: Content) -> str:
    servers: list[Mapping[str, Any]] = list(content.get("servers") or ())
    moves = sorted({str(name) for server in servers for name in server.get("moves", ())})
    waiting = sum(len(server.get("waiting", ())) for server in servers)
    parts = [counted(len(servers), "server"), f"moves {listed(moves, _MOST_NAMED)}" if moves else "nothing moves"]
    if waiting:
        parts.append(f"{waiting} wait for approval")
    if latch := content.get("latch"):
        parts.append(f"LATCHED by {latch.get('by')}: {latch.get('reason')}")
    return ", ".join(parts)


def _log(content: Content) -> str:
    lines = content.get("lines") or ()
    return f"{counted(len(lines), 'line')}, the last: {str(lines[-1].get('text', ''))[:120]}" if lines else "no line"


def _frames(content: Content) -> str:
    if "frames" not in content:
        return ""
    problems = [str(text) for text in content.get("problems") or ()]
    return f"{content['frames']} frames, {' '.join(problems[:_MOST_NAMED]) or 'no problem'}"


def _space(content: Content) -> str:
    if "frame" not in content:
        return ""
    cloud, model = content.get("cloud"), content.get("model")
    parts = [
        f"in {named(str(content['frame']))}",
        f"{cloud['count']} points of {named(str(cloud['name']))}" if cloud else "no cloud",
        counted(len(content.get("scans") or ()), "scan"),
        f"{model['shapes']} shapes of the robot" if model else "",
        counted(content["markers"]["count"], "marker") if content.get("markers") else "",
    ]
    return ", ".join(filter(None, parts))


_WORDS: Mapping[str, Callable[[Content], str]] = {
    "map": _map,
    "agent": _agent,
    "log": _log,
    "frames": _frames,
    "space": _space,
}
