"""All settings, each declared once.

Each field of `Settings` but the last is declared with `_option`. From these declarations follow the command line and
its help (`cli.py`), the environment variables, the texts of errors, what `ros2-mcp doctor` reports as set and by which
flag or variable, and `docs/reference/settings.md`. There is no other list of the options.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from ros2_mcp.model.address import LOCAL, MAX_DOMAIN_ID, RobotAddress, of_command, parse_address
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.shell import words_of

Transport = Literal["stdio", "streamable-http"]

# Fewer bytes leave no room for a message and for the note about what was cut. One desktop client refuses results of
# more than 1 MiB; the upper bound is for clients that do not, and limits the memory of this server.
_RESULT_BYTES = (1000, 10_000_000)
# The black box is kept in 16 files, each with the definitions of its types: below a megabyte there is hardly room for
# messages. The upper bound only catches typing errors.
_BLACK_BOX_BYTES = (1_000_000, 10**13)
# From half a minute, which is still useful, to more than a year, where only the limit in bytes matters.
_BLACK_BOX_HOURS = (0.01, 10_000)


def _always(_: Any) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Kind:
    """The kind of value that an option takes. `values` describes it in words; `metavar` is its name in `--help`.

    `parse` converts a text into a value, or raises `ValueError`. `allows` returns whether a value is within the bounds.
    `written` returns a value as a user would write it. `is_path`: the values are files or folders. `several`: the
    option may be repeated, and `joined` joins the repeated texts into the text that the variable would have. `adds`:
    the values of the variable are added to those of the option, so that neither overrides the other.
    """

    metavar: str = "TEXT"
    values: str = "text"
    parse: Callable[[str], Any] = str
    allows: Callable[[Any], bool] = _always
    written: Callable[[Any], str] = str
    is_path: bool = False
    several: bool = False
    joined: Callable[[Sequence[str]], str] = os.pathsep.join
    adds: bool = False


def _one_of(*choices: str) -> Kind:
    words = f"{', '.join(choices[:-1])} or {choices[-1]}"
    return Kind(f"{{{','.join(choices)}}}", words, allows=lambda value: value in choices)


def _number(low: float, high: float, kind: type[int] | type[float] = int, metavar: str = "N") -> Kind:
    """Return the kind of numbers from `low` to `high`, both included. NaN is refused. 24.0 is shown as 24."""
    words = f"a {'whole ' if kind is int else ''}number from {low} to {high}"
    return Kind(metavar, words, kind, lambda value: low <= value <= high, lambda value: f"{value:.15g}")


def _on_or_off(text: str) -> bool:
    if text.lower() not in ("1", "true", "yes", "on", "0", "false", "no", "off"):
        raise ValueError(text)
    return text.lower() in ("1", "true", "yes", "on")


def _names(metavar: str) -> Kind:
    def parse(text: str) -> tuple[str, ...]:
        return tuple(name.strip() for name in text.split(",") if name.strip())

    return Kind(metavar, "names with commas between them", parse, written=",".join)


def _path(text: str) -> Path:
    return Path(text).expanduser()


def _paths(text: str) -> tuple[Path, ...]:
    return tuple(Path(entry).expanduser() for entry in text.split(os.pathsep) if entry)


def _choices(text: str) -> tuple[str, ...]:
    return tuple(entry for entry in text.split(os.pathsep) if entry)


def _as_they_stand(text: str) -> tuple[Path, ...]:
    """Parse paths that may be on a remote robot, and so leave `~` as it is: the home folder differs there."""
    return tuple(Path(entry) for entry in text.split(os.pathsep) if entry)


def _addresses(text: str) -> tuple[RobotAddress, ...]:
    return tuple(parse_address(word) for word in text.split())


def _have_names(robots: Sequence[RobotAddress]) -> bool:
    names = [robot.name for robot in robots]
    return len(robots) < 2 or (all(names) and len(set(names)) == len(names))


def _exists(path: Path) -> bool:
    return path.expanduser().exists()


_ADDRESS = re.compile(r"https?://(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.-]+)(:[1-9]\d{0,4})?(/[A-Za-z0-9._~/-]*)?")


def _is_address(text: str) -> bool:
    return _ADDRESS.fullmatch(text) is not None


_NAME = Kind("NAME")
_URL = Kind("URL", "http:// or https:// with a host, and at most a port and a path", allows=_is_address)
_SWITCH = Kind("true|false", "1 (on) or 0 (off)", _on_or_off, written=lambda value: "true" if value else "false")
_FOLDER = Kind("DIR", "a path", _path, is_path=True)
_FILE = replace(_FOLDER, metavar="FILE")
_FILE_THAT_EXISTS = replace(_FILE, values="a file or folder that exists", allows=_exists)
_POLICIES = Kind(
    "FILE|PROFILE",
    f"files, or names of profiles (several: the option again, or {os.pathsep!r} between them in the variable)",
    _choices,
    written=os.pathsep.join,
    several=True,
    adds=True,
)
_FOLDERS = Kind(
    "DIR",
    f"paths (several: the option again, or {os.pathsep!r} between them in the variable)",
    _paths,
    written=lambda paths: os.pathsep.join(map(str, paths)),
    is_path=True,
    several=True,
)


_WORKSPACES = replace(_FOLDERS, parse=_as_they_stand)
_ROBOTS = Kind(
    "ADDRESS",
    "addresses such as ssh://user@host, docker://NAME or local, several as NAME=ADDRESS with names that differ (the "
    "option again, or a space between them in the variable)",
    _addresses,
    _have_names,
    written=lambda robots: " ".join(robot.written for robot in robots),
    several=True,
    joined=" ".join,
)
_COMMAND = Kind("COMMAND", "words as in a shell, with quotes where they have spaces", words_of, written=shlex.join)
_SSH_OPTIONS = Kind(
    "WORD",
    "words for ssh (several: the option again, or a space between them in the variable, quotes where they have spaces)",
    words_of,
    written=shlex.join,
    several=True,
    joined=shlex.join,
)
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*=[^\0]*", re.DOTALL)


def _are_variables(words: tuple[str, ...]) -> bool:
    return all(map(_VARIABLE.fullmatch, words))


_VARIABLES = replace(
    _SSH_OPTIONS,
    metavar="NAME=VALUE",
    values="variables as NAME=VALUE (several: the option again, or a space between them in the variable, quotes where "
    "they have spaces)",
    allows=_are_variables,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """The declaration of one setting.

    `name` is the name of the field, `flag` that on the command line, `variable` that in the environment. `alone` is the
    text that the flag stands for if no value follows it; None: a value must follow. `takes_value` False: no value may
    follow. `unset` describes the default in words, where the default value does not. `removed` maps values that earlier
    releases accepted to a hint of what to write instead.
    """

    name: str = ""
    default: Any
    flag: str
    variable: str
    group: str
    kind: Kind
    help: str
    unset: str = ""
    alone: str | None = None
    takes_value: bool = True
    removed: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def title(self) -> str:
        """The flag, and the variable in brackets, for messages."""
        return f"{self.flag} ({self.variable})"

    @property
    def default_text(self) -> str:
        """The default in words; "" if there is none to show."""
        return self.unset or ("" if self.default in (None, ()) else self.kind.written(self.default))

    def parse(self, text: str) -> Any:
        """Return the value of a text from the command line or the environment.

        Raises:
            BadInput: if the text is not a value of this option, or is beyond its bounds.
        """
        try:
            value = self.kind.parse(text)
        except ValueError:
            raise self._refusal(repr(text)) from None
        return self.checked(value)

    def checked(self, value: Any) -> Any:
        """Return the value unchanged. Raises `BadInput` if it is beyond the bounds."""
        if not self.kind.allows(value):
            raise self._refusal(self.kind.written(value))
        return value

    def _refusal(self, shown: str) -> BadInput:
        return BadInput(f"{self.title} is {shown}.", self.removed.get(shown, f"It must be {self.kind.values}."))


def _option(default: Any, flag: str, variable: str, group: str, kind: Kind, help: str, **more: Any) -> Any:  # noqa: A002
    declared = Option(default=default, flag=flag, variable=variable, group=group, kind=kind, help=help, **more)
    return field(default=default, metadata={"option": declared})


_ROBOT, _ROS, _SERVING, _PROMPTS, _MEMORY = "robot", "ROS 2", "serving", "prompts", "memory"


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings of one server. Default paths may begin with `~`: expand them before use."""

    # Two or three lines per option are easier to read than eight.
    # fmt: off
    robots: tuple[RobotAddress, ...] = _option(
        (), "--robot", "ROS2_MCP_ROBOT", _ROBOT, _ROBOTS,
        "the robot, over the system's ssh (ssh://user@host, ?container=NAME) or in a container here (docker://NAME)",
        unset="local: the ROS of this machine",
    )
    robots_file: Path | None = _option(
        None, "--robots", "ROS2_MCP_ROBOTS", _ROBOT, _FILE,
        "a file with several robots, each with settings of its own",
    )
    robot_command: tuple[str, ...] = _option(
        (), "--robot-command", "ROS2_MCP_ROBOT_COMMAND", _ROBOT, _COMMAND,
        "instead: a command that gives a shell where the robot is, such as 'kubectl exec -i pod --'",
    )
    ssh_options: tuple[str, ...] = _option(
        (), "--ssh-option", "ROS2_MCP_SSH_OPTION", _ROBOT, _SSH_OPTIONS,
        "handed to ssh as it stands, such as --ssh-option=-oProxyJump=gate",
    )
    robot_env: tuple[str, ...] = _option(
        (), "--robot-env", "ROS2_MCP_ROBOT_ENV", _ROBOT, _VARIABLES,
        "environment of ROS where the robot is, such as CYCLONEDDS_URI=file:///etc/cyclone.xml",
    )

    distro: str | None = _option(
        None, "--distro", "ROS2_MCP_DISTRO", _ROS, _NAME, "distribution to use, such as jazzy",
        unset="the sourced one, else the newest installed",
    )
    workspaces: tuple[Path, ...] = _option(
        (), "--workspace", "ROS2_MCP_WORKSPACE", _ROS, _WORKSPACES, "overlay to source on top; one of the robot's",
    )
    domain_id: int | None = _option(
        None, "--domain-id", "ROS_DOMAIN_ID", _ROS, _number(0, MAX_DOMAIN_ID), "DDS domain", unset="ROS's own, 0",
    )
    rmw: str | None = _option(
        None, "--rmw", "RMW_IMPLEMENTATION", _ROS, _NAME, "middleware, such as rmw_cyclonedds_cpp",
        unset="ROS's own choice",
    )
    ros_root: Path = _option(
        Path("/opt/ros"), "--ros-root", "ROS2_MCP_ROS_ROOT", _ROS, _FOLDER,
        "where the installations are, as DIR/<distro>/setup.bash, or one as DIR/setup.bash",
    )
    bridge_python: Path | None = _option(
        None, "--bridge-python", "ROS2_MCP_BRIDGE_PYTHON", _ROS, replace(_FILE, parse=Path),
        "the Python that runs the bridge", unset="that of the installation",
    )
    interface_prefixes: tuple[Path, ...] = _option(
        (), "--interfaces", "ROS2_MCP_INTERFACES", _ROS, _FOLDERS,
        "built interface packages, or folders of them, that the bridge shall find besides those of its installation",
    )
    cache_dir: Path = _option(
        Path("~/.cache/ros2-mcp"), "--cache-dir", "ROS2_MCP_CACHE_DIR", _ROS, _FOLDER,
        "for interface packages that are built here", unset="ros2-mcp below XDG_CACHE_HOME, else ~/.cache",
    )

    transport: Transport = _option(
        "stdio", "--transport", "ROS2_MCP_TRANSPORT", _SERVING, _one_of("stdio", "streamable-http"),
        "how clients reach this server",
        removed={
            "sse": "The SSE transport was removed. Write --transport streamable-http instead; clients connect to a URL "
            "that ends in /mcp, such as http://127.0.0.1:8123/mcp."
        },
    )
    host: str = _option("127.0.0.1", "--host", "ROS2_MCP_HOST", _SERVING, Kind("ADDRESS"), "address for HTTP")
    port: int = _option(8123, "--port", "ROS2_MCP_PORT", _SERVING, _number(1, 65535), "port for HTTP")
    token_file: Path | None = _option(
        None, "--token-file", "ROS2_MCP_TOKEN_FILE", _SERVING, _FILE, "who may come in over HTTP, and for what",
        unset="a token made at the first start, kept in XDG_STATE_HOME/ros2-mcp",
    )
    no_login: bool = _option(
        False, "--no-login", "ROS2_MCP_NO_LOGIN", _SERVING, _SWITCH,
        "over HTTP on this machine, let in whoever comes without a token", takes_value=False,
    )
    tls_cert: Path | None = _option(
        None, "--tls-cert", "ROS2_MCP_TLS_CERT", _SERVING, _FILE_THAT_EXISTS, "certificate for HTTPS, PEM",
    )
    tls_key: Path | None = _option(
        None, "--tls-key", "ROS2_MCP_TLS_KEY", _SERVING, _FILE_THAT_EXISTS, "key of that certificate, PEM",
    )
    behind_proxy: bool = _option(
        False, "--behind-proxy", "ROS2_MCP_BEHIND_PROXY", _SERVING, _SWITCH,
        "a proxy speaks TLS in front of this server: listen beyond this machine without", takes_value=False,
    )
    public_url: str | None = _option(
        None, "--public-url", "ROS2_MCP_PUBLIC_URL", _SERVING, _URL, "address under which clients find it, such as "
        "https://robot.example",
    )
    socket: Path | None = _option(
        None, "--socket", "ROS2_MCP_SOCKET", _SERVING, _FILE,
        "serve at this Unix socket; clients start: ros2-mcp connect PATH",
    )
    read_only: bool = _option(
        False, "--read-only", "ROS2_MCP_READONLY", _SERVING, _SWITCH, "leave out tools that write",
        takes_value=False,
    )
    policy: tuple[str, ...] = _option(
        (), "--policy", "ROS2_MCP_POLICY", _SERVING, _POLICIES,
        "what the agent may do; each has to allow it, and /etc/ros2-mcp/policy.yaml too, where it is there",
        unset="everything is allowed",
    )
    tools: tuple[str, ...] = _option(
        (), "--tools", "ROS2_MCP_TOOLS", _SERVING, _names("GROUPS"),
        "groups of tools, such as default,lifecycle, or all", unset="the default ones",
    )
    # One terminal client cuts longer texts in the middle; another takes 25,000 tokens, about 75,000 bytes.
    result_bytes: int = _option(
        12_000, "--result-bytes", "ROS2_MCP_RESULT_BYTES", _SERVING, _number(*_RESULT_BYTES),
        "bound on the text of one result",
    )
    structured: bool = _option(
        False, "--structured", "ROS2_MCP_STRUCTURED", _SERVING, _SWITCH,
        "send structured content and output schemas beside the text, for programs; some clients then hide text and "
        "pictures from the model", takes_value=False,
    )
    log_level: str = _option(
        "warning", "--log-level", "ROS2_MCP_LOG_LEVEL", _SERVING, _one_of("debug", "info", "warning", "error"),
        "what is logged on stderr; debug includes the bridge's own log",
    )

    prompts: Path | None = _option(
        None, "--prompts", "ROS2_MCP_PROMPTS", _PROMPTS, _FOLDER, "folder of your prompts in Markdown",
    )
    programs: Path = _option(
        Path("~/ros2-mcp/programs"), "--programs", "ROS2_MCP_PROGRAMS", _PROMPTS, _FOLDER,
        "for kept programs, in Markdown",
    )
    # The three names that begin with MCP_ are those of WiseVision's servers for these settings.
    custom_prompts: bool = _option(
        False, "--custom-prompts", "MCP_CUSTOM_PROMPTS", _PROMPTS, _SWITCH, "load prompts of Python packages",
        alone="true",
    )
    prompts_local: bool = _option(
        False, "--prompts-local", "MCP_PROMPTS_LOCAL", _PROMPTS, _SWITCH,
        "with --custom-prompts: load a module instead", alone="true",
    )
    prompts_path: Path | None = _option(
        None, "--prompts-path", "MCP_PROMPTS_PATH", _PROMPTS, _FOLDER, "folder of that module",
    )
    prompts_module: str = _option(
        "extension_prompts", "--prompts-module", "MCP_PROMPTS_MODULE", _PROMPTS, _NAME, "name of that module",
    )

    record_dir: Path = _option(
        Path("~/ros2-mcp/recordings"), "--record-dir", "ROS2_MCP_RECORD_DIR", _MEMORY, _FOLDER, "for recordings",
    )
    bag_dir: Path | None = _option(
        None, "--bag-dir", "ROS2_MCP_BAG_DIR", _MEMORY, _FOLDER, "where bags are read, besides the recordings",
    )
    bag: Path | None = _option(
        None, "--bag", "ROS2_MCP_BAG", _MEMORY, _FILE_THAT_EXISTS,
        "a recording in the place of the robot; needs no ROS",
    )
    black_box: tuple[str, ...] | None = _option(
        None, "--black-box", "ROS2_MCP_BLACK_BOX", _MEMORY, _names("TOPICS"),
        "always keep these topics; alone: all that have small messages", unset="nothing is kept", alone="",
    )
    # As much as the disk of a robot's computer can usually spare.
    black_box_bytes: int = _option(
        1_000_000_000, "--black-box-bytes", "ROS2_MCP_BLACK_BOX_BYTES", _MEMORY, _number(*_BLACK_BOX_BYTES),
        "most bytes that it keeps",
    )
    black_box_hours: float = _option(
        24.0, "--black-box-hours", "ROS2_MCP_BLACK_BOX_HOURS", _MEMORY, _number(*_BLACK_BOX_HOURS, float, "H"),
        "most hours that it keeps",
    )

    # fmt: on
    origins: Mapping[str, str] = field(default_factory=dict[str, str], compare=False, repr=False)
    """For each field that was set: its name, and the flag or variable that set it."""

    @property
    def debug(self) -> bool:
        """Whether the bridge's own log is shown, too."""
        return self.log_level == "debug"

    @property
    def is_http(self) -> bool:
        """Whether clients connect over HTTP."""
        return self.transport != "stdio"

    @property
    def is_stdio(self) -> bool:
        """Whether the one client uses stdin and stdout."""
        return not self.is_http and self.socket is None

    @property
    def is_here(self) -> bool:
        """Whether every robot of these settings is reached through the ROS 2 of this machine."""
        return not self.robot_command and not any(robot.is_remote for robot in self.robots)

    @property
    def robot(self) -> RobotAddress:
        """The address of the one robot of these settings.

        Raises:
            BadInput: if the settings name several robots, or both an address and a command.
        """
        if self.robots and self.robot_command:
            raise BadInput("Both --robot and --robot-command say where the robot is.", "Leave one of them out.")
        if len(self.robots) > 1:
            raise BadInput(f"{len(self.robots)} robots are named here, and one is needed.", "Give --robot once.")
        if self.robot_command:
            return of_command(self.robot_command)
        return self.robots[0] if self.robots else LOCAL

    def for_robot(self, address: RobotAddress) -> Settings:
        """Return the same settings for one robot.

        For a remote robot, drop the `ROS_DOMAIN_ID` and `RMW_IMPLEMENTATION` of this machine's environment: there, the
        robot's own environment applies, unless an option was given.
        """
        changed: dict[str, Any] = {}
        origins = dict(self.origins)
        for name in ("domain_id", "rmw") if address.is_remote else ():
            if origins.get(name) == OPTIONS[name].variable:
                changed[name] = OPTIONS[name].default
                del origins[name]
        if address.domain_id is not None:
            changed["domain_id"] = address.domain_id
        return replace(self, robots=(address,), robot_command=(), origins=origins, **changed)

    @property
    def interface_folder(self) -> Path:
        """The folder of the interface packages that were built for ROS 2 installed from wheels."""
        return self.cache_dir.expanduser() / "interfaces"

    @classmethod
    def from_environment(cls, env: Mapping[str, str] = os.environ, **overrides: Any) -> Settings:
        """Return the settings of this environment. An override that is not None takes precedence over its variable.

        Raises:
            BadInput: if a value is not allowed. It names the variable and the option, and what is allowed.
        """
        unknown = set(overrides) - set(OPTIONS)
        if unknown:
            raise BadInput(f"There is no setting {sorted(unknown)[0]!r}.")
        values: dict[str, Any] = {"cache_dir": _cache_dir(env)}
        origins: dict[str, str] = {}
        for name, option in OPTIONS.items():
            # A variable that an option overrides is not read, so it may be wrong.
            if overrides.get(name) is not None:
                values[name], origins[name] = option.checked(overrides[name]), option.flag
                if option.kind.adds and (text := env.get(option.variable, "").strip()):
                    values[name] = (*option.parse(text), *values[name])
            elif text := env.get(option.variable, "").strip():
                values[name], origins[name] = option.parse(text), option.variable
        made = cls(**values, origins=origins)
        if len(made.robots) > 1:
            return made
        return replace(made.for_robot(made.robot), robots=made.robots, robot_command=made.robot_command)


OPTIONS: Mapping[str, Option] = {
    declared.name: replace(declared.metadata["option"], name=declared.name)
    for declared in fields(Settings)
    if "option" in declared.metadata
}
"""All options by the names of their fields, in the order of `--help`."""


def _cache_dir(env: Mapping[str, str]) -> Path:
    base = Path(env.get("XDG_CACHE_HOME") or Path(env.get("HOME") or "~") / ".cache")
    return base / "ros2-mcp"
