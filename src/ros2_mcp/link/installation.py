"""A ROS 2 installation: how to run one of our packages with its Python and environment."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ros2_mcp.settings import Settings
from ros2_mcp_common.start.finding import WHEEL_GUARD, Search, in_environment

Kind = Literal["sourced", "unsourced", "wheels", "conda", "built"]

# Loads one package from its folder, so that nothing else of our environment gets on the path of ROS's Python.
_BOOTSTRAP = """\
import sys
sys.path[:] = [entry for entry in sys.path if entry]
from importlib import import_module, util
above, name = sys.argv[1:3]
del sys.argv[1:3]
for each in (name, "ros2_mcp_common"):
    folder = above + "/" + each
    spec = util.spec_from_file_location(each, folder + "/__init__.py", submodule_search_locations=[folder])
    sys.modules[each] = util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[each])
sys.argv[0] = above + "/" + name + "/__main__.py"
sys.exit(import_module(name + ".__main__").main())
"""

_OF_OUR_PYTHON = ("PYTHONHOME", "PYTHONSTARTUP", "PYTHONSAFEPATH", "__PYVENV_LAUNCHER__", WHEEL_GUARD)


@dataclass(frozen=True, slots=True)
class Command:
    """A command and its complete environment."""

    argv: Sequence[str]
    env: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RosInstallation:
    """One ROS 2 installation that was found; `why` is the reason for choosing it.

    `python` is its interpreter: a path, or a name to be looked up after sourcing `scripts` (bash setup files).
    """

    kind: Kind
    distro: str
    prefix: Path
    why: str
    python: str
    scripts: Sequence[Path] = ()
    environment: Mapping[str, str] = field(default_factory=dict[str, str])
    interface_prefixes: Sequence[Path] = ()

    def command(self, package: str, args: Sequence[str] = ()) -> Command:
        """Return the command that runs one of our packages (`ros2_mcp_bridge`, `ros2_mcp_demo`) as `python -m`
        would.
        """
        above = Path(__file__).resolve().parents[2]
        argv = [self.python, "-c", _BOOTSTRAP, str(above), package, *args]
        # Puts our interface packages before those of the installation.
        in_front = {
            "AMENT_PREFIX_PATH": os.pathsep.join(str(prefix) for prefix in self.interface_prefixes),
            "PYTHONPATH": os.pathsep.join(str(prefix / "site-packages") for prefix in self.interface_prefixes),
        }
        added = in_front if self.interface_prefixes else {}
        return Command(*in_environment(argv, self.scripts, self.environment, added))


def without_ours(env: Mapping[str, str]) -> dict[str, str]:
    """Return a copy of an environment for ROS's Python, without the settings of our Python."""
    clean = {name: value for name, value in env.items() if name not in _OF_OUR_PYTHON}
    if WHEEL_GUARD in env:
        _remove_entries(clean, "LD_LIBRARY_PATH", Path(sys.prefix))
    if sys.prefix != sys.base_prefix:
        _remove_entries(clean, "PATH", Path(sys.prefix))
        if clean.get("VIRTUAL_ENV") == sys.prefix:
            del clean["VIRTUAL_ENV"]
    return clean


def search_of(settings: Settings) -> Search:
    """Return which ROS to look for, on this machine or the robot's. Paths refer to that machine."""
    return Search(
        distro=settings.distro or "",
        python=settings.bridge_python.as_posix() if settings.bridge_python else "",
        workspaces=tuple(workspace.as_posix() for workspace in settings.workspaces),
        ros_root=settings.ros_root.as_posix(),
        domain_id=settings.domain_id,
        rmw=settings.rmw or "",
        env=dict(variable.split("=", 1) for variable in settings.robot_env),
    )


def with_a_place_for_logs(env: Mapping[str, str]) -> Mapping[str, str]:
    """Return the environment with a folder for ROS's logs: without a home folder ROS would fail at its start."""
    if env.get("HOME") or env.get("ROS_HOME"):
        return env
    return {"ROS_LOG_DIR": str(Path(tempfile.gettempdir()) / "ros2-mcp-log"), **env}


def _remove_entries(env: dict[str, str], variable: str, below: Path) -> None:
    entries = env.get(variable, "").split(os.pathsep)
    kept = [entry for entry in entries if entry and not Path(entry).is_relative_to(below)]
    if kept:
        env[variable] = os.pathsep.join(kept)
    else:
        env.pop(variable, None)
