"""Finding the processes on this machine that run in a ROS 2, and their environment; a part of `finding.py`.

A login without a terminal does not get what `.bashrc` sets in a terminal; the nodes did.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

OF_A_SOURCED_SHELL = (
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "PYTHONPATH",
    "ROS_DISTRO",
    "ROS_VERSION",
    "ROS_PYTHON_VERSION",
)
WHEEL_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""The variable by which the start-up hook of the wheels knows that their libraries can be found already."""
# The variables of a running node that matter: how it finds packages and libraries, and how it communicates.
_OF_A_NODE = re.compile(
    "|".join((*OF_A_SOURCED_SHELL, WHEEL_GUARD)) + r"|PATH|LD_LIBRARY_PATH|CONDA_PREFIX|SKIP_DEFAULT_XML"
    r"|ROS_(DOMAIN_ID|LOCALHOST_ONLY|AUTOMATIC_DISCOVERY_RANGE|STATIC_PEERS|DISCOVERY_SERVER|SUPER_CLIENT|SECURITY_\w+)"
    r"|(RMW|CYCLONEDDS|FASTRTPS|FASTDDS|ZENOH)_\w+"
)
# In wheels, the name of a library has a number appended.
_CLIENT_LIBRARY = re.compile(rb"/librcl[-.][^/\n]*so")
_OUR_NAMES = (b"ros2_mcp", b"ros2-mcp")
_INTERPRETER = re.compile(r"python(3(\.\d+)?)?")


class InRos(NamedTuple):
    """A process in a ROS 2: its relevant environment, and the Python that it runs in ("" for another program).

    `is_node`: it has loaded the ROS client library. A sourced shell has not, and may be in another domain.
    """

    variables: tuple[tuple[str, str], ...]
    python: str
    is_node: bool


def processes_in_ros(processes: Path, own: int | None = None) -> Iterator[InRos]:
    """Yield each process that runs in a ROS 2 and sees the same files, except ours.

    Only processes of the user `own` (None: the current user) count. Root could read those of everybody, but then the
    Python or the libraries that another user's process names would be executed as root.
    """
    own = os.geteuid() if own is None else own
    files = _link(processes / "self" / "ns" / "mnt")
    for process in sorted(
        (each for each in processes.iterdir() if each.name.isdigit()), key=lambda each: int(each.name)
    ):
        try:
            if process.stat().st_uid != own:
                continue
            lines = (process / "environ").read_bytes().split(b"\0")
            words = (process / "cmdline").read_bytes().split(b"\0")
        except OSError:  # another user's process, or it has ended
            continue
        pairs = (line.decode(errors="surrogateescape").partition("=") for line in lines)
        variables = {name: value for name, _, value in pairs if _OF_A_NODE.fullmatch(name)}
        # A process started by the Python of wheels has no prefix, but has the variable of their start-up hook.
        is_in_ros = variables.get("AMENT_PREFIX_PATH") or variables.get(WHEEL_GUARD)
        if is_in_ros and not _is_ours(words) and _link(process / "ns" / "mnt") == files:
            yield InRos(tuple(sorted(variables.items())), _python_of(words, process), _is_node(process))


def _is_node(process: Path) -> bool:
    try:
        return _CLIENT_LIBRARY.search((process / "maps").read_bytes()) is not None
    except OSError:
        return False


def _is_ours(words: Sequence[bytes]) -> bool:
    """Return whether a process is a bridge or server of ours. The simulated robot counts as any other robot."""
    return any(b"ros2_mcp_bridge" in word or word in _OUR_NAMES or word.endswith(b"/ros2-mcp") for word in words)


def _python_of(words: Sequence[bytes], process: Path) -> str:
    """Return the interpreter of a process as it was started, because a virtual environment is known by that path."""
    for program in (os.fsdecode(words[0]), _link(process / "exe")):
        if Path(program).is_absolute() and _INTERPRETER.fullmatch(Path(program).name):
            return program
    return ""


def others_with_nodes(processes: Path = Path("/proc"), own: int | None = None) -> list[str]:
    """Return the names of other users who run nodes here; none for root, who can read everything.

    This user cannot read what they send through shared memory (Fast DDS): their topics are listed, but silent.
    """
    own = os.geteuid() if own is None else own
    users: set[int] = set()
    for process in processes.iterdir() if own else ():
        with suppress(OSError):
            if process.name.isdigit() and b"\0--ros-args" in (process / "cmdline").read_bytes():
                users.add(process.stat().st_uid)
    return [_name_of(user) for user in sorted(users - {own})]


def _name_of(user: int) -> str:
    import pwd  # not on Windows

    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


def _link(path: Path) -> str:
    try:
        return os.readlink(path)  # noqa: PTH115 - Path's is new in 3.9
    except OSError:
        return ""
