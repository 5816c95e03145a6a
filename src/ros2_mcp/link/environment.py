"""Finding ROS 2: a sourced shell, an installation to source, or wheels in this Python's own environment.

Nothing is imported or started to decide: `rclpy` is looked for as files.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from ros2_mcp.link.installation import RosInstallation, clean_environment, wheel_environment
from ros2_mcp.link.interfaces import InterfaceCache
from ros2_mcp.link.provenance import own_provenance
from ros2_mcp.model.errors import BadInput, RosNotFound
from ros2_mcp.settings import Settings

_RELEASES = ("foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical")
_PYTHON_FOLDERS = ("lib/python3*/site-packages", "lib/python3*/dist-packages", "local/lib/python3*/dist-packages")
_WHEEL_NAME = re.compile(r"ros[-_]([a-z]+)[-_]rclpy", re.IGNORECASE)


def find_ros(settings: Settings, env: Mapping[str, str] = os.environ) -> RosInstallation:
    """The ROS 2 installation to run the bridge with: sourced, else to be sourced, else wheels.

    Raises:
        RosNotFound: if there is none, or not the distribution that was asked for; its hint is the way out.
        BadInput: if a `--workspace` has nothing to source or `--bridge-python` is not there.
    """
    installation = sourced(settings, env) or unsourced(settings, env) or wheels(settings, env)
    if not installation:
        raise _not_found(settings)
    overlays = (workspace_setup(workspace) for workspace in settings.workspaces)
    is_of_wheels = installation.kind == "wheels"
    built = InterfaceCache(settings.interface_folder).in_use(installation.prefix) if is_of_wheels else ()
    return replace(
        installation,
        scripts=(*installation.scripts, *overlays),
        interface_prefixes=tuple(dict.fromkeys((*settings.interface_prefixes, *built))),
    )


# ── a shell that was sourced ───────────────────────────────────────────────────────────────────────────────────


def sourced(settings: Settings, env: Mapping[str, str]) -> RosInstallation | None:
    """The installation of an already sourced shell, unless another distribution was asked for."""
    distro = env.get("ROS_DISTRO", "")
    prefixes = path_entries(env, "AMENT_PREFIX_PATH")
    if not distro or not prefixes or settings.distro not in (None, distro):
        return None
    on_path = (entry / "rclpy" for entry in path_entries(env, "PYTHONPATH"))
    below_prefixes = (package for prefix in prefixes for package in rclpy_below(prefix))
    package = next((package for package in (*on_path, *below_prefixes) if package.is_dir()), None)
    if not package:
        return None
    clean = clean_environment(settings, env, keep_sourced=True)
    python = _override(settings) or _interpreter(package, prefixes, clean)
    if not python:
        return None
    return RosInstallation(
        kind="sourced",
        distro=distro,
        prefix=next((entry for entry in prefixes if package.is_relative_to(entry)), prefixes[-1]),
        why=f"This shell is sourced: ROS_DISTRO={distro}, rclpy is in {package.parent}.",
        python=python,
        environment=clean,
    )


def rclpy_below(prefix: Path) -> Iterator[Path]:
    """The folders `rclpy` of a prefix, one for each Python that it was installed for."""
    folders = (folder / "rclpy" for pattern in _PYTHON_FOLDERS for folder in sorted(prefix.glob(pattern)))
    return (folder for folder in folders if folder.is_dir())


def _interpreter(package: Path, prefixes: Iterable[Path], env: Mapping[str, str]) -> str | None:
    """The Python that this rclpy was compiled for, or None if it is not on this machine.

    `python3.12` follows from the extension module in rclpy, or from the folder that it is in; else it is `python3`.
    """
    extensions = (extension.name for extension in package.glob("_rclpy_pybind11.cpython-3*"))
    versions = (re.match(r"_rclpy_pybind11\.cpython-3(\d+)", extension) for extension in extensions)
    minor = next((version[1] for version in versions if version), "")
    folder = package.parent.parent.name
    name = f"python3.{minor}" if minor else folder if re.fullmatch(r"python3(\.\d+)?", folder) else "python3"
    path = env.get("PATH", os.defpath).split(os.pathsep)
    own = [str(prefix / "bin") for prefix in prefixes]
    # Shims of version switchers are there for every version, and fail for those that are not switched on.
    real = [entry for entry in path if Path(entry).name != "shims"]
    return shutil.which(name, path=os.pathsep.join([*own, *real, "/usr/bin"]))


# ── an installation that nobody sourced ────────────────────────────────────────────────────────────────────────


def unsourced(settings: Settings, env: Mapping[str, str]) -> RosInstallation | None:
    """The newest installation below the ROS root, or the one that was asked for."""
    installed = installed_distros(settings.ros_root)
    distro = settings.distro or (installed[-1] if installed else "")
    if distro not in installed:
        return None
    prefix = settings.ros_root / distro
    clean = clean_environment(settings, env, keep_sourced=False)
    package = next(rclpy_below(prefix), None)
    # The system's own Python first: another one of that version would lack what rclpy needs, such as NumPy.
    python = _override(settings) or (package and _interpreter(package, [prefix, Path("/usr")], clean)) or "python3"
    reason = "asked for" if settings.distro else "the newest of " + ", ".join(installed)
    return RosInstallation(
        kind="unsourced",
        distro=distro,
        prefix=prefix,
        why=f"{prefix}/setup.bash is sourced for the bridge ({reason}).",
        python=python,
        scripts=(prefix / "setup.bash",),
        environment=clean,
    )


def installed_distros(root: Path) -> list[str]:
    """The distributions below the ROS root, oldest first; unknown names stand between the known ones and rolling."""
    names = (setup.parent.name for setup in root.glob("*/setup.bash"))
    return sorted(names, key=_release_order)


def _release_order(distro: str) -> tuple[int, str]:
    if distro == "rolling":
        return len(_RELEASES) + 1, distro
    return (_RELEASES.index(distro) if distro in _RELEASES else len(_RELEASES)), distro


def workspace_setup(workspace: Path) -> Path:
    """The file to source of a workspace, given by its root, its install folder or that file itself.

    Raises:
        BadInput: if there is none.
    """
    path = workspace.expanduser()
    places = (path, path / "install" / "setup.bash", path / "setup.bash")
    found = next((place for place in places if place.is_file()), None)
    if not found:
        raise BadInput(
            f"The workspace {path} has no install/setup.bash.",
            "Build it (colcon build), or give its root, its install folder or a setup.bash.",
        )
    return found.absolute()


# ── wheels ─────────────────────────────────────────────────────────────────────────────────────────────────────


def wheels(settings: Settings, env: Mapping[str, str]) -> RosInstallation | None:
    """ROS 2 wheels in the environment of the Python that runs this."""
    spec = importlib.util.find_spec("rclpy")
    distro = wheel_distro()
    if not spec or not spec.origin or not distro or settings.distro not in (None, distro):
        return None
    prefix = Path(sys.prefix)
    clean = clean_environment(settings, env, keep_sourced=False)
    return RosInstallation(
        kind="wheels",
        distro=distro,
        prefix=prefix,
        why=f"The ROS 2 wheels for {distro} are installed in {prefix}.",
        python=_override(settings) or sys.executable,
        environment=wheel_environment(clean, prefix, Path(spec.origin).parents[1]),
    )


def wheel_distro() -> str | None:
    """The distribution of the installed wheels, from the name `ros-<distro>-rclpy`; None without wheels."""
    # The folders are listed rather than read one by one: importlib.metadata would open a hundred files.
    for entry in sys.path:
        for folder in Path(entry or ".").glob("ros_*_rclpy-*.dist-info"):
            name = _WHEEL_NAME.fullmatch(folder.name.split("-")[0])
            if name:
                return name[1].lower()
    return None


def wheels_without_rclpy() -> str | None:
    """The distribution whose wheels are installed, but without what they hold; None if they are whole or not there.

    `uv sync` leaves that behind when it is run twice: the wheels bring `.egg-info` folders that it takes for strangers.
    """
    return wheel_distro() if importlib.util.find_spec("rclpy") is None else None


# ── nothing ────────────────────────────────────────────────────────────────────────────────────────────────────


def _not_found(settings: Settings) -> RosNotFound:
    incomplete = wheels_without_rclpy()
    if incomplete and settings.distro in (None, incomplete):
        return RosNotFound(
            f"The ROS 2 wheels for {incomplete} in {sys.prefix} are incomplete: rclpy is gone. Running 'uv sync' twice "
            "does that: it takes what these wheels bring for strangers.",
            f"Run: {own_provenance().reinstalling(incomplete)}. From then on 'uv run', or 'uv sync --inexact'.",
        )
    found = ", ".join(available(settings)) or "none"
    if settings.distro:
        return RosNotFound(
            f"ROS 2 {settings.distro} was asked for (--distro) and is not there; found: {found}.",
            "Leave --distro out to use what is there." if found != "none" else way_out(settings.distro),
        )
    return RosNotFound(
        f"No ROS 2 found: no sourced shell, nothing in {settings.ros_root}, no ROS 2 wheels in this Python.",
        way_out("jazzy"),
    )


def available(settings: Settings) -> list[str]:
    """The distributions that could be used without a sourced shell."""
    of_wheels = None if wheels_without_rclpy() else wheel_distro()
    return sorted({*installed_distros(settings.ros_root), *filter(None, [of_wheels])}, key=_release_order)


def way_out(distro: str) -> str:
    """The one command that gives this machine a ROS 2, if there is one."""
    if not wheels_exist_here():
        return (
            "Source an installation before starting ros2-mcp (source /opt/ros/<distro>/setup.bash); "
            f"there are no ROS 2 wheels for {platform.system()} {platform.machine()}, "
            f"Python {platform.python_version()}."
        )
    extra = distro if distro in ("jazzy", "kilted") else "jazzy"
    return (
        f"Run: {own_provenance().installing(extra)}; "
        "or source an installation first (source /opt/ros/<distro>/setup.bash)."
    )


def wheels_exist_here() -> bool:
    """Whether ROS 2 wheels are published for this machine and Python."""
    return sys.platform == "linux" and platform.machine() == "x86_64" and sys.version_info < (3, 15)


# ── common to all ──────────────────────────────────────────────────────────────────────────────────────────────


def _override(settings: Settings) -> str | None:
    if settings.bridge_python and not settings.bridge_python.is_file():
        raise BadInput(
            f"The Python for the bridge, {settings.bridge_python}, is not there.",
            "Correct or leave out --bridge-python (ROS2_MCP_BRIDGE_PYTHON).",
        )
    return str(settings.bridge_python) if settings.bridge_python else None


def path_entries(env: Mapping[str, str], variable: str) -> list[Path]:
    """The entries of a variable such as PATH."""
    return [Path(entry) for entry in env.get(variable, "").split(os.pathsep) if entry]
