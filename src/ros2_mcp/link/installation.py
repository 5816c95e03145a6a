"""A ROS 2 installation: how to run one of our packages under its Python, in its environment."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ros2_mcp.settings import Settings

Kind = Literal["sourced", "unsourced", "wheels"]

WHEEL_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"

# Loads one package by its folder, so that nothing else of our environment gets on the path of ROS's Python.
_BOOTSTRAP = """\
import sys
sys.path[:] = [entry for entry in sys.path if entry]
from importlib import import_module, util
folder, name = sys.argv[1:3]
del sys.argv[1:3]
spec = util.spec_from_file_location(name, folder + "/__init__.py", submodule_search_locations=[folder])
sys.modules[name] = util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[name])
sys.argv[0] = folder + "/__main__.py"
sys.exit(import_module(name + ".__main__").main())
"""

_OF_OUR_PYTHON = ("PYTHONHOME", "PYTHONSTARTUP", "PYTHONSAFEPATH", "__PYVENV_LAUNCHER__", WHEEL_GUARD)
_OF_A_SOURCED_SHELL = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "PYTHONPATH",
    "ROS_DISTRO",
    "ROS_VERSION",
    "ROS_PYTHON_VERSION",
)


@dataclass(frozen=True, slots=True)
class Command:
    """What to execute, with the whole environment to do it in."""

    argv: Sequence[str]
    env: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RosInstallation:
    """One ROS 2 installation that was found, and `why` it was chosen.

    `python` is its interpreter: a path, or a name to look up after `scripts` (setup files of bash) were sourced.
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
        """How to run one of our packages (`ros2_mcp_bridge`, `ros2_mcp_demo`) as `python -m` would."""
        folder = Path(__file__).resolve().parents[2] / package
        argv = [self.python, "-c", _BOOTSTRAP, str(folder), package, *args]
        # What puts our interface packages in front of those of the installation.
        added = {
            "AMENT_PREFIX_PATH": os.pathsep.join(str(prefix) for prefix in self.interface_prefixes),
            "PYTHONPATH": os.pathsep.join(str(prefix / "site-packages") for prefix in self.interface_prefixes),
        }
        if not self.interface_prefixes:
            added = {}
        if not self.scripts:
            old = self.environment
            in_front = {name: os.pathsep.join(filter(None, [paths, old.get(name)])) for name, paths in added.items()}
            return Command(argv, {**old, **in_front})
        # Sources every setup file, with the stream kept out of its reach, then becomes the Python process.
        lines = [
            *(f"source {shlex.quote(str(script))} </dev/null >&2" for script in self.scripts),
            *(f'export {name}={shlex.quote(paths)}"${{{name}:+:${name}}}"' for name, paths in added.items()),
            f"exec {shlex.join(argv)}",
        ]
        return Command(["bash", "-c", "\n".join(lines)], self.environment)


def clean_environment(settings: Settings, env: Mapping[str, str], *, keep_sourced: bool) -> dict[str, str]:
    """A copy of an environment for ROS's Python: without what belongs to ours, with what the settings ask for."""
    clean = {name: value for name, value in env.items() if name not in _OF_OUR_PYTHON}
    if WHEEL_GUARD in env:
        _remove_entries(clean, "LD_LIBRARY_PATH", Path(sys.prefix))
    if sys.prefix != sys.base_prefix:
        _remove_entries(clean, "PATH", Path(sys.prefix))
        if clean.get("VIRTUAL_ENV") == sys.prefix:
            del clean["VIRTUAL_ENV"]
    if not keep_sourced:
        for name in _OF_A_SOURCED_SHELL:
            clean.pop(name, None)
    if settings.domain_id is not None:
        clean["ROS_DOMAIN_ID"] = str(settings.domain_id)
    if settings.rmw:
        clean["RMW_IMPLEMENTATION"] = settings.rmw
    if not clean.get("HOME") and not clean.get("ROS_HOME"):
        clean.setdefault("ROS_LOG_DIR", str(Path(tempfile.gettempdir()) / "ros2-mcp-log"))
    return clean


def wheel_environment(env: Mapping[str, str], prefix: Path, site_packages: Path) -> dict[str, str]:
    """What the wheels' own start-up hook would set, so that it need not start Python a second time."""
    libraries = [str(prefix / "lib"), *sorted(str(folder) for folder in site_packages.glob("ros_*.libs"))]
    inherited = [entry for entry in env.get("LD_LIBRARY_PATH", "").split(os.pathsep) if entry]
    return {
        **env,
        "LD_LIBRARY_PATH": os.pathsep.join([*libraries, *inherited]),
        "AMENT_PREFIX_PATH": str(prefix),
        WHEEL_GUARD: "1",
    }


def _remove_entries(env: dict[str, str], variable: str, below: Path) -> None:
    entries = env.get(variable, "").split(os.pathsep)
    kept = [entry for entry in entries if entry and not Path(entry).is_relative_to(below)]
    if kept:
        env[variable] = os.pathsep.join(kept)
    else:
        env.pop(variable, None)
