"""The checks of `ros2-mcp doctor`: every way to find ROS 2, the choice, and how to repair what is wrong."""

from __future__ import annotations

import asyncio
import os
import platform
import shlex
import shutil
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ros2_mcp.link.carrier import SLOW_START, Carrier
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.link.environment import (
    find_ros,
    sourced,
    wheel_distro,
    wheels,
    wheels_exist_here,
    wheels_without_rclpy,
    workspace_setup,
)
from ros2_mcp.link.installation import RosInstallation, search_of, without_ours
from ros2_mcp.link.interfaces import InterfaceCache, package_name
from ros2_mcp.link.provenance import own_provenance
from ros2_mcp.link.remote import RemoteBridge, way_to
from ros2_mcp.model.errors import BadInput, RobotError, Unreachable
from ros2_mcp.model.text import quoted
from ros2_mcp.settings import MAX_DOMAIN_ID, Settings
from ros2_mcp_common.start.finding import installed_distros, path_entries

# A person waits at a terminal: less than a carrier's `start_s`.
PROBE_S = 15.0
# The same limit for a remote robot: 12 s for the way in, and the start of ROS on a small machine.
PROBE_FAR_S = 30.0
WAY_IN = "Way in"
_BRIDGE = "Bridge"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check: passed (True), failed (False) or for information (None); `fix` repairs a failure.

    `needs_a_person`: ssh would ask the user a question, such as whether a host key is right.
    """

    ok: bool | None
    title: str
    detail: str
    fix: str = ""
    needs_a_person: bool = False


def diagnose(settings: Settings, env: Mapping[str, str] = os.environ) -> list[Finding]:
    """Return the results of all checks that start nothing, most important first."""
    if settings.robot.is_remote:
        return list(_way_in(settings, env))
    chosen: RosInstallation | None = None
    try:
        chosen = find_ros(settings, env)
        choice = Finding(True, "ROS 2", f"{chosen.distro} ({chosen.kind}). {chosen.why}")
    except RobotError as error:
        choice = Finding(False, "ROS 2", error.message, error.hint)
    ours = f"the server runs under {platform.python_version()} ({sys.executable})"
    return [
        choice,
        *_candidates(settings, env),
        *(_workspace(workspace) for workspace in settings.workspaces),
        Finding(None, "Python", f"{ours}, the bridge under {chosen.python}" if chosen else ours),
        *(_inside(chosen, settings, env) if chosen else ()),
        *_network(settings, env),
        *_places(settings, env),
    ]


async def probe(settings: Settings, look: Callable[[Bridge], Awaitable[Finding]]) -> list[Finding]:
    """Start the bridge and return how it introduced itself, or why it did not, within a time limit; then the result of
    `look`. For a remote robot, each stage of the way in is reported as well.
    """
    started: list[Carrier] = []

    def start() -> Carrier:
        started.append(start_carrier(settings))
        return started[-1]

    bridge = Bridge(start)
    limit_s = PROBE_FAR_S if settings.robot.is_remote else PROBE_S
    found: list[Finding] = []
    try:
        hello = await asyncio.wait_for(bridge.ready(), limit_s)
        detail = f"{hello.distro} under Python {hello.python}, {hello.rmw}, domain {hello.domain_id}, {hello.executor}"
        found = [Finding(True, _BRIDGE, f"It starts: {detail}."), await look(bridge)]
    except Unreachable as error:
        found = [Finding(False, WAY_IN, error.message, error.hint, needs_a_person=error.is_lasting)]
    except RobotError as error:
        found = [Finding(False, _BRIDGE, error.message, "" if "doctor" in error.hint else error.hint)]
    except asyncio.TimeoutError:
        what = f" ({started[0].describe()})" if started else ""
        detail = f"It was not ready after {limit_s:.0f} s{what}. {' | '.join(bridge.log_tail[-5:])}"
        found = [Finding(False, _BRIDGE, detail, SLOW_START)]
    finally:
        await bridge.close()
    return [*(_stages(started[0]) if started else ()), *found]


def _way_in(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    """Check the program that reaches a remote robot."""
    robot = settings.robot
    words = way_to(settings)
    program = shutil.which(words[0], path=env.get("PATH"))
    fix = "" if program else f"Install it: {robot.place} is reached with it."
    yield Finding(bool(program), "Program", program or f"{words[0]} is not on PATH", fix)
    yield Finding(None, "Command", shlex.join(words))


def _stages(carrier: Carrier) -> Iterator[Finding]:
    """Yield the stages that were reached on the way to a remote robot, as the far side reported them."""
    if not isinstance(carrier, RemoteBridge):
        return
    arrival = carrier.arrival
    if arrival.noise.strip():
        fix = "It does no harm; programs that speak over ssh are quicker without."
        yield Finding(None, "Login", f"it prints {quoted(arrival.heard)}", fix)
    for report in arrival.reports:
        told = {name: quoted(value) for name, value in report.details.items()}
        if report.stage == "reached":
            place = carrier.address.place
            # For a container on a host, stage 1 reports the host first.
            if carrier.address.kind == "ssh" and carrier.address.container and report is arrival.reports[0]:
                place = f"{place.partition('?')[0]} (the host, not yet the container)"
            detail = f"{place}, {told.get('machine')}, python3 is {told.get('python')}"
            yield Finding(True, "Reached", f"{detail} ({told.get('executable')})")
        elif report.stage == "container":
            yield Finding(True, "Container", f"{told.get('name')} of {told.get('engine')}")
        elif report.stage == "found":
            yield Finding(True, "ROS 2", f"{told.get('distro')} ({told.get('kind')}). {report.details.get('why', '')}")
        elif report.stage == "others":
            users = (
                f"nodes of {told.get('users')} run there too: what they send by shared memory this login cannot read"
            )
            yield Finding(None, "Other users", users, "Log in as that user: ssh://USER@… (or by sudo -n -u USER).")


def _candidates(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    """Yield each way to find ROS 2, whether or not it was chosen."""
    yield _sourced_shell(settings, env)
    installed = installed_distros(settings.ros_root)
    yield Finding(None, str(settings.ros_root), ", ".join(installed) or "no installation with a setup.bash")
    distro = wheel_distro()
    if incomplete := wheels_without_rclpy():
        detail = f"ROS 2 {incomplete} in {sys.prefix}, but without rclpy: 'uv sync' that is run twice removes it"
        yield Finding(None, "Wheels", detail, f"Run: {own_provenance().reinstalling(incomplete)}")
    elif distro:
        usable = wheels(search_of(settings), env) is not None
        note = "" if usable else f"; not used, since {settings.distro} was asked for"
        yield Finding(None, "Wheels", f"ROS 2 {distro} in {sys.prefix}{note}")
    else:
        here = "none in this Python" if wheels_exist_here() else "none are published for this machine and Python"
        yield Finding(None, "Wheels", here)


def _sourced_shell(settings: Settings, env: Mapping[str, str]) -> Finding:
    title, distro = "Sourced shell", env.get("ROS_DISTRO")
    if not distro:
        return Finding(None, title, "no (ROS_DISTRO is not set)")
    if settings.distro not in (None, distro):
        return Finding(None, title, f"{distro}; not used, since {settings.distro} was asked for")
    if sourced(search_of(settings), without_ours(env)):
        return Finding(True, title, distro)
    return Finding(
        False,
        title,
        f"ROS_DISTRO is {distro}, but AMENT_PREFIX_PATH has no rclpy whose Python is on PATH.",
        "Source its setup.bash completely, or give the interpreter with ROS2_MCP_BRIDGE_PYTHON.",
    )


def _workspace(workspace: Path) -> Finding:
    try:
        return Finding(True, "Workspace", str(workspace_setup(workspace)))
    except BadInput as error:
        return Finding(False, "Workspace", error.message, error.hint)


def _inside(chosen: RosInstallation, settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    if chosen.scripts and not shutil.which("bash", path=env.get("PATH")):
        yield Finding(False, "bash", "not on PATH, but setup files must be sourced", "Run: apt-get install bash")
    requested = settings.rmw or env.get("RMW_IMPLEMENTATION", "")
    prefixes = [chosen.prefix, *path_entries(chosen.environment, "AMENT_PREFIX_PATH")]
    index = "share/ament_index/resource_index/rmw_typesupport"
    installed = sorted({entry.name for prefix in prefixes for entry in prefix.glob(f"{index}/rmw_*_c*")})
    title, listed = "Middleware", ", ".join(installed) or "none found"
    if not requested:
        yield Finding(None, title, f"ROS's own choice; installed: {listed}")
    elif requested in installed:
        yield Finding(True, title, requested)
    else:
        fix = f"Unset RMW_IMPLEMENTATION, or run: apt-get install ros-{chosen.distro}-{requested.replace('_', '-')}"
        if chosen.kind == "wheels":
            fix = "Unset RMW_IMPLEMENTATION: the wheels have Fast DDS only."
        yield Finding(False, title, f"{requested} is asked for and not installed; installed: {listed}", fix)
    yield _built_interfaces(chosen, settings)


def _built_interfaces(chosen: RosInstallation, settings: Settings) -> Finding:
    """Return which of the interface packages built without colcon this installation uses, and which others exist."""
    used = sorted({package_name(prefix) for prefix in chosen.interface_prefixes})
    others = sorted(InterfaceCache(settings.interface_folder).names() - set(used))
    detail = f"in use here: {', '.join(used) or 'none'}"
    if not others:
        return Finding(None, "Built interfaces", detail)
    detail += f"; built for other installations and not used here: {', '.join(others)}"
    fix = "ros2-mcp interfaces build DIR, with the folder of its sources, makes this one use a package."
    return Finding(None, "Built interfaces", detail, fix if chosen.kind == "wheels" else "")


def _network(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    domain = str(settings.domain_id) if settings.domain_id is not None else env.get("ROS_DOMAIN_ID", "") or "0"
    valid = domain.isdigit() and int(domain) <= MAX_DOMAIN_ID
    fix = "" if valid else f"Set ROS_DOMAIN_ID to a number from 0 to {MAX_DOMAIN_ID}, the robot's own."
    yield Finding(valid, "Domain", f"ROS_DOMAIN_ID is {domain}", fix)
    by_range = env.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in ("LOCALHOST", "OFF")
    if by_range or env.get("ROS_LOCALHOST_ONLY") == "1":
        variable = "ROS_AUTOMATIC_DISCOVERY_RANGE" if by_range else "ROS_LOCALHOST_ONLY"
        note = f"{variable} is set: robots on other machines are not seen"
        yield Finding(None, "Reach", note, f"Unset {variable} to reach a robot over the network.")


def _places(settings: Settings, env: Mapping[str, str]) -> Iterator[Finding]:
    yield _writable("Cache", settings.cache_dir.expanduser(), "Set XDG_CACHE_HOME to a folder that can be written.")
    home = env.get("ROS_HOME") or str(Path(env["HOME"]) / ".ros" if env.get("HOME") else "")
    logs = env.get("ROS_LOG_DIR") or (str(Path(home) / "log") if home else "")
    if logs:
        yield _writable("ROS log", Path(logs), "Set ROS_LOG_DIR to a folder that can be written.")


def _writable(title: str, folder: Path, fix: str) -> Finding:
    """Check whether a folder can be written, or created."""
    present = next(place for place in (folder, *folder.parents) if place.exists())
    ok = present.is_dir() and os.access(present, os.W_OK | os.X_OK)
    return Finding(ok, title, f"{folder} can{'' if ok else 'not'} be written", "" if ok else fix)
