"""Whether memory grows in a long run: `python -m bench.endurance [--minutes N] [--json FILE]`.

A server over stdio with all tools and the simulated rover, and a mixed load by several callers at once: listings,
messages, pictures, statistics, frames, parameters, subscribed resources, recordings and bags, programs, and one caller
that moves the robot in short bursts. Every 30 s the memory of each process below the server is read; at the end stand,
for each, the level after the first third (20 minutes at most, in which caches fill), the level at the end, and what is
between them; calls that failed, by tool; and how many calls were never answered, of which there must be none.

Judge by `anonymous`: what a process alone has allocated. RSS has pages of files and of DDS's shared memory, too, which
come and go with who else is in the domain.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .growth import descendants
from .processes import ENVIRONMENT, counts
from .stdio import STRUCTURED, CallFailed, StdioClient

SOURCES = Path(__file__).parents[1] / "src"
PACKAGES = ("tf2_msgs", "ros2_mcp_demo_interfaces", "nav2_msgs", "map_msgs")
"""The interface packages of the whole rover, in `src/ros2_mcp_demo/interfaces`."""
EVERY_S = 30.0
SETTLES_S = 20 * 60.0
WINDOW_S = 5 * 60.0
"""A level is the median over this time."""
ANSWERED_S = 120.0
"""Longer than any call of the load may take."""
PAUSE_S = 0.4
"""Mean pause of each caller between two calls: about ten calls a second by all callers."""
BAGS = 6
"""Number of recordings that are kept: more than the server keeps open at a time."""
TWIST = "geometry_msgs/msg/Twist"
SCALARS = ("/odom", "/scan", "/imu", "/battery_state", "/joint_states", "/diagnostics", "/heartbeat", "/tf", "/pose")
PICTURES = ("/camera/image_raw", "/camera/image_raw/compressed", "/camera/depth/image_raw", "/map")
RESOURCES = ("ros2://graph", "ros2://topics", "ros2://log", "ros2://diagnostics", "ros2://topic/odom", "ros2://actions")
LISTINGS = (
    "ros2_topic_list",
    "ros2_node_list",
    "ros2_service_list",
    "ros2_list_actions",
    "ros2_interface_list",
    "ros2_robot",
    "ros2_status",
    "ros2_policy",
    "ros2_tf_tree",
    "ros2_action_status",
    "ros2_relay_list",
    "ros2_bag_list",
    "ros2_log_read",
    "ros2_lifecycle_state",
    "ros2_parameter_list",
    "ros2_audit_read",
)


@dataclass
class Load:
    """The callers' shared client, and the number of calls by outcome."""

    client: StdioClient
    bags_folder: Path
    chance: random.Random = field(default_factory=lambda: random.Random(13))
    done: Counter[str] = field(default_factory=Counter)
    failed: Counter[str] = field(default_factory=Counter)
    overdue: Counter[str] = field(default_factory=Counter)
    recordings: int = 0

    async def call(self, tool: str, **arguments: Any) -> dict[str, Any]:
        """Call a tool as an agent does, for text without structured content; errors are counted."""
        return await self._counted(tool, "tools/call", name=tool, arguments=arguments)

    async def begin(self, what: str, tool: str, **arguments: Any) -> str:
        """Begin a job; return its id, a field of the structured content, or "" if it was refused."""
        result = await self._counted(tool, "tools/call", name=tool, arguments=arguments, _meta={STRUCTURED: True})
        return result.get("structuredContent", {}).get(what, "")

    async def _counted(self, what: str, method: str, **parameters: Any) -> dict[str, Any]:
        self.done[what] += 1
        try:
            result = await asyncio.wait_for(self.client.request(method, **parameters), ANSWERED_S)
        except asyncio.TimeoutError:
            self.overdue[what] += 1
            return {}
        except CallFailed as error:
            self.failed[f"{what}: {str(error)[:80]}"] += 1
            return {}
        if result.get("isError"):
            self.failed[f"{what}: {result['content'][0]['text'][:80]}"] += 1
        return result

    async def keep(self, caller: Callable[[Load], Awaitable[None]]) -> None:
        """Run a caller repeatedly until cancelled."""
        while True:
            await caller(self)
            await asyncio.sleep(self.chance.uniform(0.5, 1.5) * PAUSE_S)

    async def resource(self, method: str, uri: str) -> None:
        """Send a request about a resource."""
        await self._counted(f"resources/{method}", f"resources/{method}", uri=uri)


async def look(load: Load) -> None:
    """Call tools that list, describe and look up."""
    chance = load.chance
    topic = chance.choice(SCALARS)
    match chance.randrange(5):
        case 0:
            await load.call("ros2_topic_info", topic_name=topic)
        case 1:
            await load.call("ros2_tf_lookup", target="map", source=chance.choice(("base_link", "laser", "imu_link")))
        case 2:
            await load.call("ros2_get_message_fields", message_type=chance.choice((TWIST, "nav_msgs/msg/Odometry")))
        case 3:
            await load.call("ros2_parameter_get", node_name="/base_controller")
        case _:
            await load.call(chance.choice(LISTINGS))


async def read(load: Load) -> None:
    """Read messages, and values computed from them."""
    chance = load.chance
    topic = chance.choice(SCALARS)
    match chance.randrange(7):
        case 0:
            await load.call("ros2_topic_subscribe", topic_name=topic, duration=1.0, message_limit=20)
        case 1:
            await load.call("ros2_topic_echo_wait", topic_name=topic, timeout=3.0)
        case 2:
            both = [{"name": name, "duration": 1.0, "message_limit": 10} for name in chance.sample(SCALARS, 3)]
            await load.call("ros2_subscribe_multiple_topics", topics=both)
        case 3:
            await load.call("ros2_topic_statistics", topic_names=["/odom"], duration_s=1.0)
        case 4:
            await load.call("ros2_topic_stats", topic_names=["/odom", "/scan"], duration_s=1.0)
        case 5:
            await load.call("ros2_health_check", rate_check_duration_sec=1.0)
        case _:
            condition = "twist.twist.linear.x > 9"
            await load.call("ros2_wait_until", topic_name="/odom", condition=condition, timeout_s=1.0)


async def see(load: Load) -> None:
    """Read pictures."""
    chance = load.chance
    match chance.randrange(5):
        case 0:
            await load.call("ros2_scene")
        case 1:
            series = ["/odom:twist.twist.linear.x", "/imu:angular_velocity.z"]
            await load.call("ros2_plot", series=series, duration_s=1.5)
        case 2:
            await load.call("ros2_get_map_as_image")
        case _:
            await load.call("ros2_topic_subscribe", topic_name=chance.choice(PICTURES))


async def move(load: Load) -> None:
    """Make short motions of each kind, ended by themselves or by a stop. On the whole the robot stays where it is."""
    chance = load.chance
    sign = chance.choice((-1, 1))
    twist = {"linear": {"x": 0.1 * sign}, "angular": {"z": 0.3 * sign}}
    match chance.randrange(7):
        case 0:
            await load.call("ros2_topic_publish", topic_name="/cmd_vel", message_type=TWIST, data=twist)
        case 1:
            await load.call("ros2_topic_publish", topic_name="/cmd_vel", data=twist, frequency=20, duration=1.0)
        case 2:
            await load.call("ros2_drive", distance_m=0.1 * sign, speed=0.2)
        case 3:
            goal = {"x": chance.uniform(-0.5, 0.5), "y": chance.uniform(-0.5, 0.5), "tolerance": 0.2}
            await load.call("ros2_send_action_goal", action_name="/navigate_to", goal_fields=goal)
            await asyncio.sleep(1.0)
            await load.call("ros2_cancel_action_goal", action_name="/navigate_to", cancel_all=True)
        case 4:
            await load.call("ros2_service_call", service_name="/self_test", service_type="std_srvs/srv/Trigger")
        case 5:
            relay = {"source_topic": "/odom", "destination_topic": "/endurance/odom", "target_rate_hz": 5}
            await load.call("ros2_relay_start", **relay, duration_sec=1.0)
        case _:
            program = "import robot\nfor m in robot.messages('/odom', message_limit=5):\n    "
            program += "robot.publish('/cmd_vel', {'linear': {'x': 0.1}})\nprint('done')"
            await load.call("ros2_program_run", program=program, timeout_s=10)
    if chance.random() < 0.5:
        await load.call("ros2_stop")


async def remember(load: Load) -> None:
    """Record, read the recording, play it back under other names, and delete the oldest recording."""
    load.recordings += 1
    name = f"run{load.recordings}"
    topics = ["/odom", "/scan", "/imu", "/tf", "/tf_static"]
    recording = await load.begin("recording_id", "ros2_record_start", topic_names=topics, name=name)
    await asyncio.sleep(3.0)
    await load.call("ros2_record_status")
    await load.call("ros2_record_stop", recording_id=recording)
    await load.call("ros2_bag_info", bag=name)
    await load.call("ros2_bag_read", bag=name, topic_name="/odom", message_limit=5)
    await load.call("ros2_topic_statistics", topic_names=["/odom"], bag=name)
    await load.call("ros2_scene", bag=name)
    played = {"topics": ["/odom"], "remaps": {"/odom": "/endurance/played"}, "wait_sec": 0}
    if playback := await load.begin("playback_id", "ros2_bag_play", bag=name, **played):  # a stop may forbid it
        await asyncio.sleep(1.0)
        await load.call("ros2_bag_play_stop", playback_id=playback)
    shutil.rmtree(load.bags_folder / f"run{load.recordings - BAGS}", ignore_errors=True)


async def compute(load: Load) -> None:
    """Run programs that read, and one that fails."""
    programs = (
        "import robot\nprint([m['_topic'] for m in robot.messages('/odom', '/scan', message_limit=10)])",
        "import robot\nprint(robot.latest('/battery_state'))",
        "print(sum(i * i for i in range(20000)))",
        "x = {}\nx['y']",
    )
    await load.call("ros2_program_run", program=load.chance.choice(programs), timeout_s=10)
    await asyncio.sleep(2.0)


async def listen(load: Load) -> None:
    """Subscribe to a resource, read it, and unsubscribe after a while."""
    uri = load.chance.choice(RESOURCES)
    await load.resource("subscribe", uri)
    await load.resource("read", uri)
    await asyncio.sleep(4.0)
    await load.resource("unsubscribe", uri)


CALLERS = (look, look, read, read, see, move, remember, compute, listen)


@dataclass(frozen=True)
class Memory:
    """The memory of one process in MB, `at_s` after the beginning."""

    at_s: float
    process: str
    rss: float
    pss: float
    anonymous: float
    threads: int
    files: int


def processes(server: int) -> dict[int, str]:
    """Return the server and all processes below it, by kind: stoppers and sandboxes have process names of their own."""
    found = {server: "server"}
    for pid in descendants(server):
        with suppress(OSError):
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            name = Path(f"/proc/{pid}/comm").read_text().strip()
            found[pid] = "bridge" if b"ros2_mcp_bridge" in command and name.startswith("python") else name
    return found


def memory(pid: int, kind: str, at_s: float) -> Memory:
    """Return the memory of a process as the kernel reports it; raises OSError if it has ended."""
    lines = (line.split() for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:])
    megabytes = {line[0].rstrip(":"): int(line[1]) / 1024 for line in lines}
    threads, files = counts(pid)
    return Memory(
        round(at_s, 1), f"{kind} {pid}", *(megabytes[name] for name in ("Rss", "Pss", "Anonymous")), threads, files
    )


async def sample(server: int, began: float, taken: list[Memory]) -> None:
    """Sample every process every 30 s until cancelled."""
    while True:
        for pid, kind in processes(server).items():
            with suppress(OSError, KeyError):  # the process has just ended
                taken.append(memory(pid, kind, time.monotonic() - began))
        await asyncio.sleep(EVERY_S)


def level(samples: list[Memory], since_s: float, until_s: float) -> dict[str, float]:
    """Return the medians within a span of time; empty without samples."""
    within = [one for one in samples if since_s <= one.at_s <= until_s]
    names = ("rss", "pss", "anonymous", "threads", "files")
    return {name: statistics.median(getattr(one, name) for one in within) for name in names} if within else {}


def report(taken: list[Memory], seconds: float) -> list[str]:
    """Return a line for each process that has samples at the beginning and at the end of the comparison."""
    settled = min(SETTLES_S, seconds / 3)
    window = min(WINDOW_S, seconds / 6)
    lines: list[str] = []
    for process in dict.fromkeys(one.process for one in taken):
        own = [one for one in taken if one.process == process]
        before, after = level(own, settled, settled + window), level(own, seconds - window, seconds + EVERY_S)
        if not before or not after:
            continue
        parts = [
            f"{name} {before[name]:.1f} → {after[name]:.1f} ({after[name] - before[name]:+.1f})" for name in before
        ]
        lines.append(f"{process}: {', '.join(parts)}")
    return lines


def environment(folder: Path) -> dict[str, str]:
    """Return the bench's environment, with the rover's interfaces and a state folder of its own."""
    sources = [str(SOURCES / "ros2_mcp_demo" / "interfaces" / package) for package in PACKAGES]
    command = [sys.executable, "-m", "ros2_mcp_interfaces", *sources]
    prefixes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    sites = [f"{prefix}/site-packages" for prefix in prefixes]
    return {
        **ENVIRONMENT,
        "PYTHONPATH": os.pathsep.join(filter(None, [*sites, os.environ.get("PYTHONPATH")])),
        "AMENT_PREFIX_PATH": os.pathsep.join([*prefixes, sys.prefix]),
        "XDG_STATE_HOME": str(folder / "state"),
    }


def rover_in(variables: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start the rover and wait until it is ready; it ends with its standard input."""
    command = [sys.executable, "-m", "ros2_mcp_demo", "--until-stdin-closes"]
    rover = subprocess.Popen(
        command, env=variables, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert rover.stdout and rover.stdout.readline()
    return rover


async def run(seconds: float) -> tuple[dict[str, Any], bool]:
    """Run the load; return the measurements, and whether all calls were answered."""
    taken: list[Memory] = []
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        variables = environment(folder)
        rover = rover_in(variables)
        options = ("--tools", "all", "--record-dir", str(folder / "bags"))
        try:
            async with StdioClient([sys.executable, "-m", "ros2_mcp", *options], variables) as client:
                await client.greet()
                load, began = Load(client, folder / "bags"), time.monotonic()
                sampling = asyncio.ensure_future(sample(client.pid, began, taken))
                calling = [asyncio.ensure_future(load.keep(caller)) for caller in CALLERS]
                while time.monotonic() - began < seconds:
                    await asyncio.sleep(min(300.0, seconds))
                    elapsed = time.monotonic() - began
                    print(f"{elapsed / 60:.0f} min, {load.done.total()} calls", flush=True)
                    print("\n".join(report(taken, elapsed)), flush=True)
                for one in calling:
                    one.cancel()
                await asyncio.wait(calling)
                # The server also answers the calls that were cancelled here; wait for these answers.
                deadline = time.monotonic() + ANSWERED_S
                while client.owed() and time.monotonic() < deadline:
                    await asyncio.sleep(0.1)
                owed = client.owed()
                sampling.cancel()
        finally:
            rover.communicate(timeout=20)
    print(f"calls: {load.done.total()} · never answered: {owed} · late: {dict(load.overdue)}")
    for what, number in load.failed.most_common():
        print(f"failed {number} × {what}")
    kept = {"done": load.done, "failed": load.failed, "owed": owed, "memory": [vars(one) for one in taken]}
    return kept, not owed and not load.overdue


def main() -> None:
    parser = argparse.ArgumentParser("bench.endurance", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="for how long (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all samples there")
    arguments = parser.parse_args()
    kept, is_answered = asyncio.run(run(arguments.minutes * 60))
    if arguments.json:
        arguments.json.write_text(json.dumps(kept) + "\n")
    sys.exit(not is_answered)


if __name__ == "__main__":
    main()
