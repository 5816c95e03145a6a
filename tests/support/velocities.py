"""The four velocity types: fields as an agent writes them, bytes made by hand, and hostile ones of both."""

from __future__ import annotations

import math
import os
import random
import struct
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from support.processes import SHARED, python_path

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ACKERMANN, ACKERMANN_STAMPED = "ackermann_msgs/msg/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"
VELOCITY_TYPES = (TWIST, TWIST_STAMPED, ACKERMANN, ACKERMANN_STAMPED)
STAMPED = (TWIST_STAMPED, ACKERMANN_STAMPED)
HUGE = "@1e400@"
"""In arguments of a `Driver`: written as the number 1e400, which Python's JSON would write as Infinity."""
PACKAGE = {
    "package.xml": "<package><name>ackermann_msgs</name><version>2.0.2</version><license>BSD</license></package>",
    "msg/AckermannDrive.msg": "\n".join(
        f"float32 {name}" for name in ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
    ),
    "msg/AckermannDriveStamped.msg": "std_msgs/Header header\nAckermannDrive drive",
}
"""ROS's ackermann_msgs, which is not among the packages that the tests install."""
NOT_FINITE = (math.nan, math.inf, -math.inf, HUGE, "nan", "inf", "-Infinity", "1e400")
"""What an agent may write in the place of a number."""
ODD = (*NOT_FINITE, 1e308, -1e308, 5e-324, 2.2e-308, 3.5e38, 1e39, "0x10", None, True, [], {}, [[1.0]], "0.5 m/s")
FLOATS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 3.5e38, 1e-45, 0.5)
STAMPS = ((0, 0), (2**31 - 1, 999_999_999), (-(2**31), 0), (1, 2**32 - 1), (2_000_000_000, 10**9), (-1, 5))
LEAST = 4
"""Bytes that are left of a message that is cut: after one with fewer, Fast DDS delivers nothing of that publisher."""
FRAMES = ("", "base_link", "x" * 5000, "\n::\x1b[31m")


def speed(kind: str, value: Any, header: dict[str, Any] | None = None) -> dict[str, Any]:
    """The fields of a velocity command of a type with one number that is not its default."""
    inner = {"speed": value} if "Ackermann" in kind else {"linear": {"x": value}}
    if kind not in STAMPED:
        return inner
    whole = {"drive" if "Ackermann" in kind else "twist": inner}
    return whole if header is None else {"header": header, **whole}


def path_of_speed(kind: str) -> str:
    """How the name of that number is written."""
    inner = "speed" if "Ackermann" in kind else "linear.x"
    return {TWIST_STAMPED: f"twist.{inner}", ACKERMANN_STAMPED: f"drive.{inner}"}.get(kind, inner)


def cdr(
    kind: str,
    value: float,
    *,
    stamp: tuple[int, int] = (0, 0),
    frame: str = "base",
    order: str = "<",
    rest: float = 0.0,
) -> bytes:
    """The bytes of a velocity command whose first number is the value, and all others `rest`."""
    width, count = (4, 5) if "Ackermann" in kind else (8, 6)
    body = b""
    if kind in STAMPED:
        text = frame.encode() + b"\0"
        # as C++ does, seconds and nanoseconds wrap round
        body = struct.pack(f"{order}III", stamp[0] % 2**32, stamp[1] % 2**32, len(text)) + text
        body += bytes(-len(body) % width)
    numbers = [value, *([rest] * (count - 1))]
    if width == 4:
        numbers = [number if abs(number) < 3.4e38 or not math.isfinite(number) else math.inf for number in numbers]
    body += struct.pack(f"{order}{count}{'f' if width == 4 else 'd'}", *numbers)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + body


def hostile_bytes(kind: str, seed: int) -> Iterator[bytes]:
    """Messages without an end: odd numbers and stamps, cut, with bytes behind, of the other endianness, noise."""
    dice = random.Random(f"{kind} {seed}")
    while True:
        made = cdr(
            kind,
            dice.choice(FLOATS),
            stamp=dice.choice(STAMPS),
            frame=dice.choice(FRAMES),
            order=dice.choice("<>"),
            rest=dice.choice(FLOATS),
        )
        spoil = dice.randrange(6)
        if spoil == 0:
            made = made[: dice.randrange(LEAST, len(made))]
        elif spoil == 1:
            made += dice.randbytes(dice.randrange(1, 64))
        elif spoil == 2:
            made = made[:4] + dice.randbytes(len(made) - 4)
        elif spoil == 3:
            made = bytes([dice.randrange(256), dice.randrange(256)]) + made[2:]
        yield made


def hostile_fields(kind: str, seed: int) -> Iterator[dict[str, Any]]:
    """The same as an agent may write it: odd numbers and stamps, texts, nested ones, fields that do not exist."""
    dice = random.Random(f"{kind} fields {seed}")
    while True:
        sec, nanosec = dice.choice(STAMPS)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": dice.choice(FRAMES)}
        fields = speed(kind, dice.choice(ODD), dice.choice((None, header)))
        if dice.randrange(8) == 0:
            fields = {**fields, dice.choice(("header", "speed", "linear", "twist", "odd")): dice.choice(ODD)}
        yield fields


@cache
def ackermann_prefix() -> Path:
    """Where ackermann_msgs is built: once on a machine, since it takes ten seconds."""
    folder = SHARED / f"ros2-mcp-test-interfaces-{os.getuid()}"
    for name, text in PACKAGE.items():
        file = folder / "ackermann_msgs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists() or file.read_text() != f"{text}\n":
            file.write_text(f"{text}\n")
    command = [sys.executable, "-m", "ros2_mcp_interfaces", str(folder / "ackermann_msgs"), "--cache", str(folder)]
    environment = {**os.environ, "PYTHONPATH": python_path(), "AMENT_PREFIX_PATH": sys.prefix}
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)
    assert run.returncode == 0, run.stderr
    return Path(run.stdout.split()[-1])


def with_ackermann(environment: dict[str, str]) -> dict[str, str]:
    """The environment of a server and an observer that know the types of ackermann_msgs too."""
    prefix = ackermann_prefix()
    return {
        **environment,
        "PYTHONPATH": f"{prefix / 'site-packages'}{os.pathsep}{environment['PYTHONPATH']}",
        "AMENT_PREFIX_PATH": f"{prefix}{os.pathsep}{sys.prefix}",
        "ROS2_MCP_INTERFACES": str(prefix),
    }
