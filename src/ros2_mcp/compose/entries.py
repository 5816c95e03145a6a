"""The robots of one server, each with its own settings: the robots of `--robot`, and the robots in the file of
`--robots`.

The file is never searched for: a client may start a server in any folder, and a file there must not choose hosts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ros2_mcp.guard.policy_file import PROFILES, opened, policy_for
from ros2_mcp.guard.section import PolicyFileError, Section, parse
from ros2_mcp.guard.state import state_of
from ros2_mcp.model.address import MAX_DOMAIN_ID, RobotAddress, of_command, parse_address
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import listed, quoted
from ros2_mcp.settings import OPTIONS, Settings

_ROBOT = "robot="
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,31}")
"""The name of a robot, which is used in URIs and as the name of a folder."""
_NAMES = "A name has letters and digits, behind the first one also . _ and -; 32 of them at most."
_MOST_NAMED = 15
"""The most names in one error text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One robot of a server: its name, which is empty for the only robot, and its own settings."""

    name: str
    settings: Settings


def entries_of(settings: Settings) -> Sequence[Entry]:
    """Return the robots that the settings name, the file's robots first, in order; at least one.

    If there are several, each records into its own folder, with its name, within the record folder.

    Raises:
        BadInput: naming the line of the file, or the two names of one robot.
    """
    if settings.bag or (settings.robots_file is None and len(settings.robots) < 2):
        return [Entry(name="", settings=settings)]
    if settings.robot_command:
        raise BadInput(
            "--robot-command is for a server with one robot; several robots are configured.",
            "In the robots file, give each robot its own `command:`.",
        )
    origins = {name: origin for name, origin in settings.origins.items() if name != "robots_file"}
    common = replace(settings, robots_file=None, origins=origins)
    found = [*(_read(common, settings.robots_file) if settings.robots_file else ())]
    found += [(address.name, common.for_robot(address)) for address in settings.robots]
    _check_names([name for name, _ in found])
    if len(found) == 1:
        return [Entry(name="", settings=found[0][1])]
    entries = [Entry(name=name, settings=replace(own, record_dir=own.record_dir / name)) for name, own in found]
    _check_states(entries)
    return entries


def only_one(settings: Settings, what: str) -> Settings:
    """Return the settings of the only robot. Raises `BadInput` if there are several; `what` is the name of
    the command.
    """
    entries = entries_of(settings)
    if len(entries) > 1:
        folders = (f"{state_of(one.settings, policy_for(one.settings)).path} is {one.name}" for one in entries)
        hint = f"Name one: --robot ADDRESS alone; or its state folder with --state: {', '.join(folders)}."
        raise BadInput(f"{what} is about one robot, and there are {len(entries)}.", hint)
    return entries[0].settings


def named_in(settings: Settings, words: Sequence[str], *, needed: bool) -> tuple[Settings, Sequence[str]]:
    """Return the settings of the robot that a word `robot=NAME` of a command line names, and the other words.

    Without such a word: the settings of the only robot, or of the first if a name is not `needed`.

    Raises:
        BadInput: if there are several robots and none of them is named.
    """
    entries = entries_of(settings)
    if len(entries) == 1:
        return entries[0].settings, words
    named = [word.removeprefix(_ROBOT) for word in words if word.startswith(_ROBOT)]
    if not named and not needed:
        return entries[0].settings, words
    found = next((entry for entry in entries if named and entry.name == named[-1]), None)
    if found is None:
        problem = f"There is no robot {quoted(named[-1])}." if named else "There are several robots, and none is named."
        raise BadInput(problem, f"Give {_ROBOT}NAME: {listed([one.name for one in entries], _MOST_NAMED)}.")
    return found.settings, [word for word in words if not word.startswith(_ROBOT)]


def _check_names(names: Sequence[str]) -> None:
    if "" in names:
        raise BadInput(
            "With --robots each robot needs a name.", "Write it before the address: --robot lab=ssh://me@lab."
        )
    if wrong := [name for name in names if not _NAME.fullmatch(name)]:
        raise BadInput(f"{quoted(wrong[0])} is not a valid robot name.", _NAMES)
    if double := [name for name, times in Counter(map(str.lower, names)).items() if times > 1]:
        raise BadInput(f"Two robots are called {double[0]!r}.", "Give them names that differ in more than case.")


def _check_states(entries: Iterable[Entry]) -> None:
    """Raise `BadInput` if two entries are the same robot, also because of a shared policy: they would share a latch and
    an audit.
    """
    known: dict[Path, str] = {}
    for entry in entries:
        folder = state_of(entry.settings, policy_for(entry.settings)).path
        if folder in known:
            raise BadInput(
                f"{known[folder]} and {entry.name} are one robot to this server: both keep their state in {folder}.",
                "Give them addresses or domains that differ; a policy that has 'robot' or 'state' is for one robot.",
            )
        known[folder] = entry.name


# ── the file of robots ───────────────────────────────────────────────────────────────────────────────────────────


def _read(settings: Settings, path: Path) -> list[tuple[str, Settings]]:
    """Return the name and settings of each robot in the file, in order."""
    path = path.expanduser()
    try:
        # As with a policy, other users must not be able to change it: it names hosts and commands to run.
        top = parse(opened(path), str(path), "the file of robots", "Begin with: robots:")
        top.require("robots")
        found = [
            (name, _of_section(settings, name, section, path.parent.absolute()))
            for name, section in top.named_sections("robots", "the robot").items()
        ]
        top.done()
    except PolicyFileError as error:  # it is not a policy: the same error under a suitable name
        raise BadInput(error.message, error.hint) from None
    return found


def _of_section(settings: Settings, name: str, section: Section, folder: Path) -> Settings:
    """Return the settings of one robot of the file. What the file does not set is as for all robots of this server."""
    if not _NAME.fullmatch(name):
        raise section.error(section.node, f"{quoted(name)} is not a valid robot name.", _NAMES)
    address = _address(name, section)
    given: dict[str, Any] = {
        "distro": section.text("distro"),
        "rmw": section.text("rmw"),
        "workspaces": tuple(map(Path, section.texts("workspaces"))),  # on the robot: not looked up here
        "bridge_python": Path(section.text("python")) if section.has("python") else None,
        "ssh_options": (*settings.ssh_options, *section.texts("ssh_options")),
        "robot_env": (*settings.robot_env, *_variables(section)),
        "policy": (*settings.policy, *(_policy(text, folder) for text in section.texts("policy"))),
        "read_only": section.flag("read_only") or settings.read_only,
    }
    domain_id = section.number("domain_id", low=0, high=MAX_DOMAIN_ID)
    if domain_id is not None:
        if not domain_id.is_integer():
            raise section.error_at("domain_id", "domain_id must be a whole number.")
        if address.domain_id is not None:
            raise section.error_at("domain_id", "the address names a domain_id, too: leave one of them out.")
        address = replace(address, domain_id=int(domain_id))
    section.done()
    return replace(settings.for_robot(address), **{key: value for key, value in given.items() if value})


def _address(name: str, section: Section) -> RobotAddress:
    """Return the address of the robot, from `at` or `command`."""
    has_command = section.has("command")
    if has_command == section.has("at"):
        raise section.error(section.node, f"{section.what} needs 'at' or 'command', and one of them alone.")
    if has_command:
        return of_command(section.texts("command"), name)
    try:
        return parse_address(f"{name}={section.text('at')}")
    except BadInput as error:
        raise section.error_at("at", error.message, error.hint) from None


def _variables(section: Section) -> tuple[str, ...]:
    """Return the variables under `env`, in the form of `--robot-env`."""
    if not (env := section.section("env")):
        return ()
    given = {name: f"{name}={env.text(name)}" for name in env.all()}
    for name, variable in given.items():
        if not OPTIONS["robot_env"].kind.allows((variable,)):
            raise env.error_at(name, f"{quoted(name)} is not the name of a variable.")
    return tuple(given.values())


def _policy(text: str, folder: Path) -> str:
    """Return the name of a profile, or the path of a file relative to the folder of the robots' file."""
    return text if text in PROFILES else str(folder / Path(text).expanduser())
