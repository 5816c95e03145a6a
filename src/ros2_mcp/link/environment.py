"""Find the ROS 2 of this machine. Nothing is imported or started for that: `rclpy` is searched for as files.

All ways except the wheels in this Python's own environment are those of `finding.py`, which the far side of a remote
robot uses as well.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from ros2_mcp.link.installation import Kind, RosInstallation, search_of, with_a_place_for_logs, without_ours
from ros2_mcp.link.interfaces import SHIPPED, InterfaceCache, package_name
from ros2_mcp.link.provenance import own_provenance
from ros2_mcp.model.errors import BadInput, RosNotFound
from ros2_mcp.settings import Settings
from ros2_mcp_common.start import finding
from ros2_mcp_common.start.finding import installed_distros, release_order


def find_ros(settings: Settings, env: Mapping[str, str] = os.environ) -> RosInstallation:
    """Return the ROS 2 of this machine in which to run the bridge.

    In this order: a sourced shell; a ROS built in a given workspace or root; the newest below the ROS root; wheels; an
    environment of conda or pixi; a workspace in the home folder in which ROS was built.

    Raises:
        RosNotFound: if there is none, or not the requested distribution; its hint says how to get one.
        BadInput: if a `--workspace` has no setup file or `--bridge-python` does not exist.
    """
    search, env = search_here(settings), {**without_ours(env), **search_of(settings).env}
    overlays = [workspace_setup(workspace) for workspace in settings.workspaces]
    ways = (sourced, finding.given, finding.unsourced, wheels, finding.conda, finding.built_from_source)
    found = next(filter(None, (way(search, env) for way in ways)), None)
    if not found:
        raise _not_found(search)
    built = _built_for(found, settings) if found.kind == "wheels" else ()
    given = [prefix for folder in settings.interface_prefixes for prefix in _prefixes_in(folder)]
    return RosInstallation(
        kind=cast("Kind", found.kind),
        distro=found.distro,
        prefix=found.prefix,
        why=found.why,
        python=found.python,
        scripts=tuple(dict.fromkeys((*found.scripts, *overlays))),
        environment=with_a_place_for_logs(found.environment),
        interface_prefixes=tuple(dict.fromkeys((*given, *built))),
    )


def search_here(settings: Settings) -> finding.Search:
    """Return which ROS to look for on this machine.

    Raises:
        BadInput: if `--bridge-python` does not exist.
    """
    python = settings.bridge_python.expanduser() if settings.bridge_python else None
    if python and not python.is_file():
        raise BadInput(
            f"The Python for the bridge, {python}, is not there.",
            "Correct or leave out --bridge-python (ROS2_MCP_BRIDGE_PYTHON).",
        )
    return replace(search_of(settings), python=str(python or ""), ros_root=str(settings.ros_root.expanduser()))


def _prefixes_in(folder: Path) -> Sequence[Path]:
    """Return the prefixes in a folder, or the folder itself if it is a prefix, or does not exist yet because it is
    still being built.
    """
    index = Path("share") / "ament_index"
    held = [] if (folder / index).is_dir() else sorted(found.parents[1] for found in folder.glob(f"*/{index}"))
    return held or (folder,)


def sourced(search: finding.Search, env: Mapping[str, str]) -> finding.Found | None:
    """Return the installation of an already sourced shell, unless another distribution is requested."""
    return finding.sourced(search, env) if env.get("ROS_DISTRO") else None


def workspace_setup(workspace: Path) -> Path:
    """Return the setup file of a workspace, given by its root, its install folder or the file itself.

    Raises:
        BadInput: if there is none.
    """
    try:
        return finding.workspace_setup(str(workspace))
    except finding.NotFound as error:
        raise BadInput(error.message, error.hint) from error


# ── wheels ─────────────────────────────────────────────────────────────────────────────────────────────────────


def wheels(search: finding.Search, env: Mapping[str, str]) -> finding.Found | None:
    """Return the ROS 2 wheels in the environment of this Python, or None."""
    spec = importlib.util.find_spec("rclpy")
    distro = wheel_distro()
    if not spec or not spec.origin or not distro or search.distro not in ("", distro):
        return None
    prefix = Path(sys.prefix)
    clean = finding.environment_for(search, env, keep_sourced=False)
    return finding.Found(
        kind="wheels",
        distro=distro,
        prefix=prefix,
        why=f"The ROS 2 wheels for {distro} are installed in {prefix}.",
        python=search.python or sys.executable,
        environment=finding.wheel_environment(clean, prefix, Path(spec.origin).parents[1]),
    )


def wheel_distro() -> str | None:
    """Return the distribution of the installed wheels, from the name `ros-<distro>-rclpy`; None without wheels."""
    return finding.wheel_distro(Path(entry or ".") for entry in sys.path) or None


def wheels_without_rclpy() -> str | None:
    """Return the distribution whose wheels are installed without their files; None if they are complete or missing.

    Running `uv sync` twice causes this: it removes the `.egg-info` folders of the wheels, which it does not know.
    """
    return wheel_distro() if importlib.util.find_spec("rclpy") is None else None


def _built_for(installation: finding.Found, settings: Settings) -> tuple[Path, ...]:
    """Return the interface packages that were built for these wheels, and the shipped packages if built for equal
    wheels.
    """
    cache = InterfaceCache(settings.interface_folder)
    own = cache.in_use(installation.prefix)
    if installation.python != sys.executable:  # another Python may need other extensions
        return own
    known = {package_name(built) for built in own}
    if known >= cache.names() & {sources.name for sources in SHIPPED.iterdir()}:
        return own  # without further search, which would slow down each start
    return (*own, *(built for built in cache.shipped() if package_name(built) not in known))


# ── nothing ────────────────────────────────────────────────────────────────────────────────────────────────────


def _not_found(search: finding.Search) -> RosNotFound:
    incomplete = wheels_without_rclpy()
    if incomplete and search.distro in ("", incomplete):
        return RosNotFound(
            f"The ROS 2 wheels for {incomplete} in {sys.prefix} are incomplete: rclpy is gone. Running 'uv sync' twice "
            "does that: it removes files of these wheels.",
            f"Run: {own_provenance().reinstalling(incomplete)}. From then on 'uv run', or 'uv sync --inexact'.",
        )
    found = ", ".join(_available(search)) or "none"
    if search.distro:
        return RosNotFound(
            f"ROS 2 {search.distro} was requested (--distro) but not found; found: {found}.",
            "Leave --distro out to use what is there." if found != "none" else way_out(search.distro),
        )
    return RosNotFound(
        f"No ROS 2 found: no sourced shell, nothing in {search.ros_root}, no ROS 2 wheels in this Python, no conda or "
        "pixi environment with it, no workspace in the home folder in which it was built.",
        f"{way_out('jazzy')} If it is elsewhere on this machine, name the folder of its setup.bash: --ros-root DIR.",
    )


def _available(search: finding.Search) -> list[str]:
    """Return the distributions that could be used without a sourced shell."""
    of_wheels = None if wheels_without_rclpy() else wheel_distro()
    return sorted({*installed_distros(Path(search.ros_root)), *filter(None, [of_wheels])}, key=release_order)


_ELSEWHERE = "A robot elsewhere needs no ROS here: --robot ssh://me@robot."


def way_out(distro: str) -> str:
    """Return the command, if any, that installs ROS 2 on this machine, and a hint that remote robots need no ROS 2
    here.
    """
    if sys.platform == "win32":
        return "Name the robot: --robot ssh://user@host. In WSL, ros2-mcp finds the ROS 2 that is installed there."
    if not wheels_exist_here():
        return (
            "Source an installation before starting ros2-mcp (source /opt/ros/<distro>/setup.bash); "
            f"there are no ROS 2 wheels for {platform.system()} {platform.machine()}, "
            f"Python {platform.python_version()}. {_ELSEWHERE}"
        )
    extra = distro if distro in ("jazzy", "kilted") else "jazzy"
    return (
        f"Run: {own_provenance().installing(extra)}; "
        f"or source an installation first (source /opt/ros/<distro>/setup.bash). {_ELSEWHERE}"
    )


def wheels_exist_here() -> bool:
    """Return whether ROS 2 wheels are published for this machine and Python."""
    return sys.platform == "linux" and platform.machine() == "x86_64" and sys.version_info < (3, 15)
