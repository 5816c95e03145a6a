"""The independent observer as the tests command it, and the interfaces that it and the server need beside ROS's own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from support.agent import until
from support.commanded import CommandedProcess
from support.processes import python_path

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ACKERMANN, ACKERMANN_STAMPED = "ackermann_msgs/msg/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"
VELOCITY_TYPES = (TWIST, TWIST_STAMPED, ACKERMANN, ACKERMANN_STAMPED)
STAMPED = (TWIST_STAMPED, ACKERMANN_STAMPED)
PACKAGE = {
    "package.xml": "<package><name>ackermann_msgs</name><version>2.0.2</version><license>BSD</license></package>",
    "msg/AckermannDrive.msg": "\n".join(
        f"float32 {name}" for name in ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
    ),
    "msg/AckermannDriveStamped.msg": "std_msgs/Header header\nAckermannDrive drive",
}
"""The two types of ROS's ackermann_msgs, which is not among the packages that the tests install."""


def speed(kind: str, value: Any) -> dict[str, Any]:
    """The fields of a velocity command of a type with one number that is not its default."""
    inner = {"speed": value} if "Ackermann" in kind else {"linear": {"x": value}}
    if kind not in STAMPED:
        return inner
    return {"drive" if "Ackermann" in kind else "twist": inner}


@cache
def ackermann_prefix() -> Path:
    """Where ackermann_msgs is built: once on a machine, as it takes half a minute."""
    folder = Path(tempfile.gettempdir()) / f"ros2-mcp-test-interfaces-{os.getuid()}"
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


class Observer(CommandedProcess):
    """`observer_peer`; its commands are methods, see there."""

    def __init__(self, environment: dict[str, str]) -> None:
        super().__init__("observer_peer", environment)

    def watch(self, topic: str, kind: str = TWIST, late_s: tuple[float, ...] = ()) -> list[str]:
        """Four subscribers on a topic, and as many more as come late: three kinds, two of them apart; their names."""
        names = [f"{topic} {what}" for what in ("reliable", "best effort", "apart", "best effort apart")]
        for by, best_effort, apart in zip(names, (0, 1, 0, 1), (0, 0, 1, 1), strict=True):
            self.join(by=by, topic=topic, kind=kind, best_effort=bool(best_effort), apart=bool(apart))
        for number, after_s in enumerate(late_s):
            by = f"{topic} late {number}"
            self.join(by=by, topic=topic, kind=kind, after_s=after_s, best_effort=bool(number % 2), apart=True)
            names.append(by)
        return names

    def until_driven(self, topic: str, number: int = 1, of: int = 1) -> None:
        """Wait until so many subscribers have got at least so many messages that move the robot."""
        until(lambda: sum(count >= number for count in self.driven(topic=topic).values()) >= of)

    def comes_to_rest(self, topic: str, within_s: float) -> list[str]:
        """The subscribers that a last message still moves when that time is over; returns as soon as there are none."""
        end = time.monotonic() + within_s
        while (left := self.moving(topic=topic)) and time.monotonic() < end:
            time.sleep(0.02)
        return left


@contextmanager
def observing(environment: dict[str, str]) -> Iterator[Observer]:
    """An observer for the time of a block."""
    observer = Observer(environment)
    try:
        yield observer
    finally:
        observer.kill()
