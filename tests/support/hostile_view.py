"""A recording whose every name, value and message would break the page that shows it, or run in it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory.record import CALLS
from support.made_windows import encoded
from support.room_bag import START_NS

STEP_NS = 100_000_000
LONG = 1_000_000
"""Characters."""
_BASES = (
    *("<script>hit()</script>", "<img src=x onerror=hit()>", '"><svg/onload=hit()>', "</script><script>hit()//"),
    *("</style><script>hit()</script>", "<iframe srcdoc='<script>parent.hit()</script>'>", "javascript:hit()"),
    *("<a href='javascript:hit()'>x</a>", "<math><mi xlink:href='data:,x'>", "<base href=//evil.example>"),
    *("<meta http-equiv=refresh content='0;url=//evil.example'>", "<form action=//evil.example><input autofocus>"),
    *("<template><script>hit()</script></template>", "<!-- <script>hit()", "]]><x:script>hit()</x:script>"),
    *("${hit()}", "{{constructor.constructor('hit()')()}}", "');hit();('", '";hit();"', "`;hit();`"),
    *("__proto__", "constructor", "toString", "hasOwnProperty", "' onmouseover='hit()' x='", "&lt;script&gt;hit()"),
    *("url(//evil.example/x.png)", "expression(hit())", "%3Cscript%3Ehit()%3C/script%3E", "\u202egnp.exe<script>"),
    *("\u2028hit()\u2029", "Z\u0351\u036b\u0343\u036a\u0302" * 200, "W" * 5000, "\n" * 3000, "🏴" * 500),
)
_DRESSES: tuple[Callable[[str], str], ...] = (
    lambda text: text,
    str.upper,
    lambda text: f"//{text}",
    lambda text: f'"{text}"',
    lambda text: f"'>{text}<'",
    lambda text: text.replace("<", "<\t"),
    lambda text: text.replace("=", "\n="),
    lambda text: text + text,
    lambda text: f"</option></select>{text}",
    lambda text: text.replace("hit", "top.hit"),
    lambda text: "".join(f"&#{ord(one)};" for one in text[:200]),
)
_NUMBERS = ("nan", "inf", "-inf", 1e300, -1e300, 5e-324, 0.0, 1e9)
_SINGLES = ("nan", "inf", "-inf", 3e38, -3e38, 1e-45, 0.0, 1e9)
"""The same of single precision."""


def payloads(most: int) -> list[str]:
    """As many different texts, spread over all kinds."""
    every = [dress(base) for dress in _DRESSES for base in _BASES]
    whole = [*dict.fromkeys(every)]
    assert most <= len(whole)
    return [whole[number * len(whole) // most] for number in range(most)]


def write_hostile_view(folder: Path, texts: list[str]) -> Path:
    """One text for each tenth of a second: the name of a topic, its value, frames, log lines, what an agent did."""
    folder.mkdir()
    writer = BagWriter(folder, folder.name)
    known: set[str] = set()
    for number, text in enumerate(texts):
        at_ns = START_NS + number * STEP_NS
        for topic, kind, value in _messages(number, text):
            if topic not in known:
                known.add(topic)
                writer.add_topic(StoredTopic(topic, kind, None, "", "", qos_text([QoS()])))
            writer.write(topic, Sample(at_ns, at_ns, number + 1, encoded(kind, value)))
    writer.close()
    return folder


def _messages(number: int, text: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    bad, single = _NUMBERS[number % len(_NUMBERS)], _SINGLES[number % len(_NUMBERS)]
    stamp = {"sec": START_NS // 10**9, "nanosec": number * STEP_NS % 10**9}
    header = {"stamp": stamp, "frame_id": "map" if number % 3 else text}
    long = text if number % 25 else text + "<b>" * (LONG // 3)
    yield f"/{number} {text[:200]}", "std_msgs/msg/String", {"data": text}
    yield "/text", "std_msgs/msg/String", {"data": f"#{number}# {long}"}
    log = {"stamp": stamp, "level": (number * 7) % 256, "name": text, "msg": f"{number} {long}", "file": text}
    yield "/rosout", "rcl_interfaces/msg/Log", log
    yield CALLS, "std_msgs/msg/String", {"data": _call(number, text)}
    yield "/camera", "sensor_msgs/msg/Image", {"header": header, **_image(number, text)}
    yield "/map", "nav_msgs/msg/OccupancyGrid", {"header": {**header, "frame_id": "map"}, **_grid(number, bad, single)}
    edges = [("map", "base_link", 0.1 * number), ("map", text, bad), (text, "laser", 0.0), ("base_link", "laser", bad)]
    transforms = [
        {
            "header": {"stamp": stamp, "frame_id": parent},
            "child_frame_id": child,
            "transform": {"translation": {"x": x, "y": 0.0}, "rotation": {"w": bad if number % 5 == 0 else 1.0}},
        }
        for parent, child, x in edges
    ]
    yield "/tf", "tf2_msgs/msg/TFMessage", {"transforms": transforms}
    laser = {
        "angle_min": single,
        "angle_max": 1.0,
        "angle_increment": 0.0 if number % 2 else single,
        "range_max": single,
    }
    yield (
        "/scan",
        "sensor_msgs/msg/LaserScan",
        {"header": header, **laser},
    )
    poses = [{"header": header, "pose": {"position": {"x": bad, "y": 1.0}}}, {"header": {"frame_id": text}}]
    yield "/plan", "nav_msgs/msg/Path", {"header": header, "poses": poses * (number % 7)}
    goal = {"position": {"x": bad, "y": bad}, "orientation": {"z": bad}}
    yield "/goal_pose", "geometry_msgs/msg/PoseStamped", {"header": header, "pose": goal}


def _call(number: int, text: str) -> str:
    """A line that stands for one of the audit, with fields of all types; each seventh is none."""
    odd: list[Any] = [text, number, -1e308, None, True, [text], {text: [text]}, {"__proto__": {"x": text}}]

    def field(at: int) -> Any:
        return odd[(number + at) % len(odd)]

    nested: Any = text
    for _ in range(60):
        nested = {text[:20]: nested}
    fields = {"tool": text, "verb": field(0), "name": field(1), "reason": field(2), "outcome": field(3)}
    fields |= {"rate_hz": field(4), "duration_s": field(5), "by": field(6), "program": field(7), "value": nested}
    kind = ("act", "refused", "waits", "latched", "goal ended", "outcome")[number % 6]
    return text if number % 7 == 6 else json.dumps({"kind": kind, "time": field(8), "of": field(9), **fields})


def _image(number: int, text: str) -> dict[str, Any]:
    encodings = ("rgb8", "mono8", "32FC1", "16UC1", text, "bayer_rggb8", "")
    sizes = ((4, 4, 12), (0, 0, 0), (2**31, 2, 6), (2, 2**31, 4), (3, 5, 0), (1, 1, 2**31), (640, 480, 1))
    (width, height, step), encoding = sizes[number % 7], encodings[number // 7 % 7]
    data = [number % 256] * (0, 1, 47, 48, 49, 5000)[number % 6]
    return {"width": width, "height": height, "step": step, "encoding": encoding, "data": data}


def _grid(number: int, bad: Any, single: Any) -> dict[str, Any]:
    sizes = ((10, 10), (0, 0), (2**31, 2**31), (10, 9), (1, 100), (2**32 - 1, 1))
    width, height = sizes[number % 6]
    x, w = bad if number % 4 == 1 else -1.0, 0.0 if number % 4 == 2 else 1.0
    origin = {"position": {"x": x}, "orientation": {"w": w}}
    info = {"resolution": (0.1, single, 0.0, -0.1)[number % 4], "width": width, "height": height, "origin": origin}
    return {"info": info, "data": [number % 128 - 1] * (100, 0, 99, 101)[number // 6 % 4]}
