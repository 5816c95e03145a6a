"""Everything that the command line and the environment can set."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from ros2_mcp.model.errors import BadInput

Transport = Literal["stdio", "sse", "streamable-http"]

TRANSPORTS = ("stdio", "sse", "streamable-http")
LOG_LEVELS = ("debug", "info", "warning", "error")
MAX_DOMAIN_ID = 232

_YES = ("1", "true", "yes", "on")
_NO = ("", "0", "false", "no", "off")


@dataclass(frozen=True, slots=True)
class Settings:
    """What one server was asked to be.

    `domain_id` and `rmw` are None where ROS itself shall decide from the bridge's environment. `tools` names the
    groups to offer; empty means all. `result_bytes` bounds the text of one result. `ros_root` is where the
    installations of ROS 2 stand (`<ros_root>/<distro>/setup.bash`). `interface_prefixes` are built interface
    packages that the bridge shall find besides those of its installation. `prompts` is a folder of prompts in Markdown.
    `custom_prompts` lets prompts in Python code be loaded: of installed packages, or, with `prompts_local`, of the
    module `prompts_module` in the folder `prompts_path`. Recordings are written below `record_dir`; bags are read there
    and below `bag_dir`. `bag` is a recording that stands for the robot. `black_box` names the topics that are always
    kept (none: all with small messages), at most so many bytes and hours of them; None keeps nothing.
    """

    transport: Transport = "stdio"
    host: str = "127.0.0.1"
    port: int = 8123
    read_only: bool = False
    distro: str | None = None
    workspaces: tuple[Path, ...] = ()
    domain_id: int | None = None
    rmw: str | None = None
    bridge_python: Path | None = None
    tools: tuple[str, ...] = ()
    log_level: str = "warning"
    result_bytes: int = 32_000
    ros_root: Path = Path("/opt/ros")
    interface_prefixes: tuple[Path, ...] = ()
    cache_dir: Path = Path("~/.cache/ros2-mcp")
    record_dir: Path = Path("~/ros2-mcp/recordings")
    bag_dir: Path | None = None
    bag: Path | None = None
    black_box: tuple[str, ...] | None = None
    black_box_bytes: int = 1_000_000_000
    black_box_hours: float = 24.0
    custom_prompts: bool = False
    prompts: Path | None = None
    prompts_local: bool = False
    prompts_path: Path | None = None
    prompts_module: str = "extension_prompts"

    @property
    def debug(self) -> bool:
        """Whether the bridge's own log is shown too."""
        return self.log_level == "debug"

    @property
    def interface_folder(self) -> Path:
        """Where interface packages that were built for wheels are kept."""
        return self.cache_dir.expanduser() / "interfaces"

    @classmethod
    def from_environment(cls, env: Mapping[str, str] = os.environ, **overrides: Any) -> Settings:
        """The settings of this environment; an override that is not None wins over it.

        Raises:
            BadInput: naming the variable or option whose value cannot be used, and what would be right.
        """
        unknown = set(overrides) - {field.name for field in fields(cls)}
        if unknown:
            raise BadInput(f"There is no setting {sorted(unknown)[0]!r}.")
        given = {name: value for name, value in overrides.items() if value is not None}
        return _checked(replace(_from_variables(env, given), **given))


def _from_variables(env: Mapping[str, str], given: Mapping[str, Any]) -> Settings:
    """The settings that the variables make; one that an option overrides is not even looked at."""
    values: dict[str, Any] = {"cache_dir": _cache_dir(env)}
    for variable, (name, parse) in _VARIABLES.items():
        text = env.get(variable, "")
        if text.strip() and name not in given:
            values[name] = parse(variable, text.strip())
    return Settings(**values)


def _cache_dir(env: Mapping[str, str]) -> Path:
    base = Path(env.get("XDG_CACHE_HOME") or Path(env.get("HOME") or "~") / ".cache")
    return base / "ros2-mcp"


def _checked(settings: Settings) -> Settings:
    _require_one_of("--transport (ROS2_MCP_TRANSPORT)", settings.transport, TRANSPORTS)
    _require_one_of("--log-level (ROS2_MCP_LOG_LEVEL)", settings.log_level, LOG_LEVELS)
    _require_between("--port (ROS2_MCP_PORT)", settings.port, 1, 65535)
    _require_between("--result-bytes (ROS2_MCP_RESULT_BYTES)", settings.result_bytes, 1000, 10_000_000)
    _require_between("--black-box-bytes (ROS2_MCP_BLACK_BOX_BYTES)", settings.black_box_bytes, 1_000_000, 10**13)
    if not 0.01 <= settings.black_box_hours <= 10_000:
        raise BadInput(f"--black-box-hours is {settings.black_box_hours:g}.", "It must be from 0.01 to 10000.")
    if settings.bag is not None and not settings.bag.expanduser().exists():
        raise BadInput(f"--bag (ROS2_MCP_BAG): there is no {settings.bag}.", "Give a bag's file or folder.")
    if settings.domain_id is not None:
        _require_between("--domain-id (ROS_DOMAIN_ID)", settings.domain_id, 0, MAX_DOMAIN_ID)
    return settings


def _require_one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise BadInput(f"{name} is {value!r}.", f"It can be {', '.join(allowed[:-1])} or {allowed[-1]}.")


def _require_between(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise BadInput(f"{name} is {value}.", f"It must be a whole number from {low} to {high}.")


def _text(_variable: str, text: str) -> str:
    return text


def _number(variable: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise BadInput(f"{variable} is {text!r}.", "It must be a whole number.") from None


def _switch(variable: str, text: str) -> bool:
    if text.lower() not in _YES + _NO:
        raise BadInput(f"{variable} is {text!r}.", "It must be 1 (on) or 0 (off).")
    return text.lower() in _YES


def _names(_variable: str, text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _path(_variable: str, text: str) -> Path:
    return Path(text).expanduser()


def _paths(_variable: str, text: str) -> tuple[Path, ...]:
    return tuple(Path(entry).expanduser() for entry in text.split(os.pathsep) if entry)


_VARIABLES: Mapping[str, tuple[str, Any]] = {
    "ROS2_MCP_TRANSPORT": ("transport", _text),
    "ROS2_MCP_HOST": ("host", _text),
    "ROS2_MCP_PORT": ("port", _number),
    "ROS2_MCP_READONLY": ("read_only", _switch),
    "ROS2_MCP_DISTRO": ("distro", _text),
    "ROS2_MCP_WORKSPACE": ("workspaces", _paths),
    "ROS_DOMAIN_ID": ("domain_id", _number),
    "RMW_IMPLEMENTATION": ("rmw", _text),
    "ROS2_MCP_BRIDGE_PYTHON": ("bridge_python", _path),
    "ROS2_MCP_TOOLS": ("tools", _names),
    "ROS2_MCP_LOG_LEVEL": ("log_level", _text),
    "ROS2_MCP_RESULT_BYTES": ("result_bytes", _number),
    "ROS2_MCP_ROS_ROOT": ("ros_root", _path),
    "ROS2_MCP_INTERFACES": ("interface_prefixes", _paths),
    "ROS2_MCP_PROMPTS": ("prompts", _path),
    "ROS2_MCP_RECORD_DIR": ("record_dir", _path),
    "ROS2_MCP_BAG_DIR": ("bag_dir", _path),
    "ROS2_MCP_BAG": ("bag", _path),
    "ROS2_MCP_BLACK_BOX": ("black_box", _names),
    "ROS2_MCP_BLACK_BOX_BYTES": ("black_box_bytes", _number),
    "MCP_CUSTOM_PROMPTS": ("custom_prompts", _switch),
    "MCP_PROMPTS_LOCAL": ("prompts_local", _switch),
    "MCP_PROMPTS_PATH": ("prompts_path", _path),
    "MCP_PROMPTS_MODULE": ("prompts_module", _text),
}
