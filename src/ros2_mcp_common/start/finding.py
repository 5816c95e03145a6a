"""Finding a ROS 2 on this machine, and how to run a program in it.

The server uses this module for its own machine, stage 1 (`stage1.py`) for the far side, before anything is known of it.
So it needs only the standard library of Python 3.8 and, of ours, `nodes_here.py`. `rclpy` is searched for as files;
nothing of ROS is imported.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import time
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ros2_mcp_common.start.nodes_here import OF_A_SOURCED_SHELL, WHEEL_GUARD, processes_in_ros

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

RELEASES = ("foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical")
# Releases without what the bridge needs of rclpy, which came with Humble (see docs/reference/platforms.md).
TOO_OLD = ("foxy", "galactic")
# The variables of a running node that say with which nodes it communicates.
_OF_THE_NETWORK = re.compile(
    r"(ROS_(DOMAIN|LOCAL|AUTO|STATIC|DISCOVERY)|RMW_IMPL|CYCLONEDDS_URI|FASTRTPS_DEFAULT|ZENOH_)\w*"
)
_PYTHON_FOLDERS = ("lib/python3*/site-packages", "lib/python3*/dist-packages", "local/lib/python3*/dist-packages")
_WHEEL = re.compile(r"ros[-_]([a-z]+)[-_]rclpy", re.IGNORECASE)
_CONDA_PACKAGE = re.compile(r"ros2?-([a-z]+)-rclpy-\d.*\.json")
_ENVIRONMENTS_OF_CONDA = (
    "~/*conda3",
    "~/*forge3",
    "~/*conda3/envs/*",
    "~/*forge3/envs/*",
    "~/micromamba/envs/*",
    "~/.conda/envs/*",
    "/opt/*conda*",
    "/opt/*conda*/envs/*",
    "/opt/*forge*",
    "/opt/*forge*/envs/*",
    "~/.pixi/envs/*",
    "~/*/.pixi/envs/*",
)
_OWN_WORKSPACES = ("~/ros2_ws/install", "~/*_ws/install", "~/ros2_*/install")
# Files in which `ros_environment` records the distribution, in a merged and in an isolated install folder.
_OF_THE_DISTRO = (
    "share/ros_environment/environment/*ros_distro.sh",
    "ros_environment/share/ros_environment/environment/*ros_distro.sh",
)
_DISTRO_IN_IT = re.compile(r"\bROS_DISTRO=[\"']?(\w+)")
# The time limit of one program: a Python starts in 20 ms, from an SD card in a second or two.
_PYTHON_S = 10.0
# The time limit for all Pythons on PATH together: stage 1 ends itself 30 s after its start, and ROS has to start in
# that time, too.
_PYTHONS_S = 15.0
# The most Pythons to try: on PATH, where version switchers, environments and the system have one each; and of running
# nodes.
_MOST_PYTHONS, _MOST_PYTHONS_OF_NODES = 12, 2
# The program by which another Python reports whether it has rclpy.
_TELL = """\
import sys
sys.path[:] = filter(None, sys.path)  # the working folder is no place for modules
import importlib.util, json
spec = importlib.util.find_spec("rclpy")
print(json.dumps({"prefix": sys.prefix, "rclpy": spec.origin if spec else None}))
"""


class NotFound(Exception):
    """Raised if there is no such ROS 2: what there is instead, and what to do."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


def _none() -> dict[str, str]:
    return {}


@dataclass(frozen=True)
class Search:
    """Which ROS 2 to look for, and what to add to its environment. Paths are those of the machine that is searched."""

    distro: str = ""
    python: str = ""
    workspaces: Sequence[str] = ()
    ros_root: str = "/opt/ros"
    domain_id: int | None = None
    rmw: str = ""
    env: Mapping[str, str] = field(default_factory=_none)

    def as_json(self) -> dict[str, Any]:
        """Return the search as JSON for stage 1, the inverse of `from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, search: Mapping[str, Any]) -> Search:
        """Return the search from the JSON of `as_json`."""
        return cls(**search)


@dataclass(frozen=True)
class Found:
    """A ROS 2 installation, and `why` it was chosen.

    `python` is its interpreter: a path, or a name to look up after `scripts` (setup files for bash) were sourced.
    """

    kind: str
    distro: str
    prefix: Path
    why: str
    python: str
    scripts: Sequence[Path] = ()
    environment: Mapping[str, str] = field(default_factory=_none)

    def running(self, words: Sequence[str]) -> tuple[list[str], dict[str, str]]:
        """Return the words to execute, and their whole environment, to run `words` in this ROS 2."""
        return in_environment(words, self.scripts, self.environment)


def in_environment(
    words: Sequence[str], scripts: Sequence[Path], env: Mapping[str, str], in_front: Mapping[str, str] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Return words and environment that run `words` after the setup files were sourced.

    Args: words: program and arguments. scripts: setup files for bash, in order; they get neither stdin nor stdout. env:
    the environment before sourcing. in_front: paths to put in front of variables such as PYTHONPATH, after sourcing.
    """
    added = in_front or {}
    if not scripts:
        first = {name: os.pathsep.join(filter(None, [paths, env.get(name)])) for name, paths in added.items()}
        return list(words), {**env, **first}
    lines = [
        *(f"source {shlex.quote(str(script))} </dev/null >&2" for script in scripts),
        *(f'export {name}={shlex.quote(paths)}"${{{name}:+:${name}}}"' for name, paths in added.items()),
        "exec " + " ".join(map(shlex.quote, words)),
    ]
    return ["bash", "-c", "\n".join(lines)], dict(env)


# ── the far side: all ways ─────────────────────────────────────────────────────────────────────────────────────


def find(search: Search, env: Mapping[str, str]) -> Found:
    """Return the ROS 2 of a machine of which nothing is known, with the workspaces to source after it.

    Searches in this order: a given Python; a sourced environment; that of running ROS processes; a ROS 2 built in a
    given folder; the newest installation; conda or pixi; a workspace in the home folder in which ROS 2 was built; a
    Python on PATH that has rclpy.

    Raises:
        NotFound: if there is none, or not the requested one.
    """
    env = {**env, **search.env}
    python = str(Path(search.python).expanduser()) if search.python else ""
    if python and not shutil.which(python, path=env.get("PATH")):
        hint = "Give the path of the one that ROS 2 there uses (--bridge-python PATH), or none."
        raise NotFound(f"The Python {search.python} is not there.", hint)
    search = replace(search, python=python)
    found = (
        (python_with_rclpy(search, env) if python else None)
        or sourced(search, env)
        or running(search, env)
        or given(search, env)
        or unsourced(search, env)
        or conda(search, env)
        or built_from_source(search, env)
        or (None if python else python_with_rclpy(search, env))
    )
    if not found:
        raise _nothing(search, env)
    if found.distro in TOO_OLD:
        raise NotFound(
            f"ROS 2 {found.distro} is too old: it ended in {found.prefix} with less than the bridge needs.",
            "Humble is the oldest supported version.",
        )
    overlays = [workspace_setup(workspace) for workspace in search.workspaces] or own_workspace(found)
    return replace(found, scripts=tuple(dict.fromkeys((*found.scripts, *overlays))))


def _nothing(search: Search, env: Mapping[str, str]) -> NotFound:
    there = installed_distros(Path(search.ros_root))
    if search.distro and there:
        wrong = f"ROS 2 {search.distro} was asked for and is not there; found: {', '.join(there)}."
        return NotFound(wrong, "Choose one of these with --distro NAME, or leave --distro out.")
    containers = ", ".join(containers_with_ros(env))
    distro = f"without --distro {search.distro} any other will do" if search.distro else "--distro NAME chooses one"
    hint = (
        "Say where it is, in paths of that machine: --bridge-python PATH for a Python that has rclpy, --workspace DIR "
        f"for a workspace, --ros-root DIR for what is not in /opt/ros; {distro}."
    )
    if containers:
        hint = f"Containers run there in which it may be: {containers}. Add ?container=NAME to the address. {hint}"
    return NotFound(
        f"No ROS 2 found there: no process of this user's that runs in one, nothing in {search.ros_root}, no conda or "
        "pixi environment with it, no python3 that has rclpy.",
        hint,
    )


def containers_with_ros(env: Mapping[str, str]) -> list[str]:
    """Return the names and images of the running containers, at most 10; none if this user may not ask the engine."""
    engine = shutil.which("docker", path=env.get("PATH")) or shutil.which("podman", path=env.get("PATH"))
    if not engine:
        return []
    said = _output([engine, "ps", "--format", "{{.Names}} ({{.Image}})"], env)
    return said.splitlines()[:10]


# ── a shell that was sourced ───────────────────────────────────────────────────────────────────────────────────


def sourced(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 of an already sourced environment; None if another distribution was requested."""
    prefixes = path_entries(env, "AMENT_PREFIX_PATH")
    on_path = (entry / "rclpy" for entry in path_entries(env, "PYTHONPATH"))
    below_prefixes = (package for prefix in prefixes for package in rclpy_below(prefix))
    package = next((package for package in (*on_path, *below_prefixes) if package.is_dir()), None)
    distro = env.get("ROS_DISTRO", "") or (wheel_distro([package.parent]) if package else "")
    if not prefixes or not distro or not package or search.distro not in ("", distro):
        return None
    clean = environment_for(search, env, keep_sourced=True)
    python = search.python or interpreter(package, prefixes, clean)
    if not python:
        return None
    return Found(
        kind="sourced",
        distro=distro,
        prefix=next((entry for entry in prefixes if entry in package.parents), prefixes[-1]),
        why=f"This shell is sourced: ROS_DISTRO={distro}, rclpy is in {package.parent}.",
        python=python,
        environment=clean,
    )


def rclpy_below(prefix: Path) -> Iterator[Path]:
    """Yield the folders `rclpy` below a prefix, one for each Python for which it was installed."""
    folders = (folder / "rclpy" for pattern in _PYTHON_FOLDERS for folder in sorted(prefix.glob(pattern)))
    return (folder for folder in folders if folder.is_dir())


def interpreter(package: Path, prefixes: Iterable[Path], env: Mapping[str, str]) -> str | None:
    """Return the Python for which this rclpy was compiled, or None if it is not on this machine.

    Its name, such as `python3.12`, follows from the extension module in rclpy, or from the folder that contains it;
    otherwise it is `python3`.
    """
    extensions = (extension.name for extension in package.glob("_rclpy_pybind11.cpython-3*"))
    versions = (re.match(r"_rclpy_pybind11\.cpython-3(\d+)", extension) for extension in extensions)
    minor = next((version[1] for version in versions if version), "")
    folder = package.parent.parent.name
    name = f"python3.{minor}" if minor else folder if re.fullmatch(r"python3(\.\d+)?", folder) else "python3"
    path = env.get("PATH", os.defpath).split(os.pathsep)
    own = [str(prefix / "bin") for prefix in prefixes]
    # Version switchers have shims for every version, which fail for a version that is not switched on.
    real = [entry for entry in path if Path(entry).name != "shims"]
    return shutil.which(name, path=os.pathsep.join([*own, *real, "/usr/bin"]))


# ── processes that run ─────────────────────────────────────────────────────────────────────────────────────────


def running(search: Search, env: Mapping[str, str], processes: Path = Path("/proc")) -> Found | None:
    """Return the ROS 2 of this user's processes, with their domain and middleware: that of the most nodes.

    Processes that are no nodes, such as sourced shells, count only if there is no node. A login without a terminal does
    not get what `.bashrc` sets in a terminal; the nodes did.
    """
    every = list(processes_in_ros(processes))
    pythons = {each.variables: each.python for each in every}
    asked = {""}
    for are_nodes in (True, False):
        environments = Counter(each.variables for each in every if each.is_node == are_nodes)
        for variables, count in environments.most_common():
            merged = {**env, **dict(variables), **search.env}
            found = sourced(search, merged)
            python = pythons[variables]
            if not found and not search.python and python not in asked and len(asked) <= _MOST_PYTHONS_OF_NODES:
                # Wheels outside their prefix, such as those installed for a user: only the Python itself knows where
                # they are.
                asked.add(python)
                found = python_with_rclpy(replace(search, python=python), merged)
            if found:
                words = [f"{name}={value}" for name, value in variables if _OF_THE_NETWORK.fullmatch(name)]
                others = sum(environments.values()) - count
                mixed = f" ({others} another one)" if others else ""
                one, several = ("node", "nodes") if are_nodes else ("process", "processes")
                found_in = f"1 running {one} has it" if count == 1 else f"{count} running {several} have it"
                why = f"{found_in}{mixed}: {', '.join(words) or 'default settings'}."
                return replace(found, kind="running", why=why)
    return None


# ── an installation that is not sourced ────────────────────────────────────────────────────────────────────────


def unsourced(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the newest installation below the ROS root, or the requested distribution; None if it is not there."""
    root = Path(search.ros_root)
    installed = installed_distros(root)
    distro = search.distro or (installed[-1] if installed else "")
    if distro not in installed:
        return None
    prefix = root / distro
    clean = environment_for(search, env, keep_sourced=False)
    package = _rclpy_in(prefix)
    distro = distro_of(prefix) or distro  # the folder may have another name, for example `install`
    # The system's own Python comes first: another one of that version would lack what rclpy needs, such as NumPy.
    python = search.python or (package and interpreter(package, [prefix, Path("/usr")], clean)) or "python3"
    reason = "asked for" if search.distro else "the newest of " + ", ".join(installed)
    return Found(
        kind="unsourced",
        distro=distro,
        prefix=prefix,
        why=f"{prefix}/setup.bash is sourced for the bridge ({reason}).",
        python=python,
        scripts=(prefix / "setup.bash",),
        environment=clean,
    )


def installed_distros(root: Path) -> list[str]:
    """Return the distributions below the ROS root, oldest first.

    Unknown names come after the known ones, before rolling.
    """
    names = (setup.parent.name for setup in root.glob("*/setup.bash"))
    return sorted(names, key=release_order)


def release_order(distro: str) -> tuple[int, str]:
    """Return a key by which to sort distributions, oldest first."""
    if distro == "rolling":
        return len(RELEASES) + 1, distro
    return (RELEASES.index(distro) if distro in RELEASES else len(RELEASES)), distro


# ── conda, pixi, a workspace that holds ROS itself ─────────────────────────────────────────────────────────────


def conda(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 of a conda or pixi environment: the active environment, else the newest in the usual places."""
    own = [Path(env["CONDA_PREFIX"])] if env.get("CONDA_PREFIX") else []
    pixi = [folder for workspace in search.workspaces for folder in _places(f"{workspace}/.pixi/envs/*", env)]
    places = [*own, *pixi, *(folder for pattern in _ENVIRONMENTS_OF_CONDA for folder in _places(pattern, env))]
    usable = [(_conda_distro(prefix), prefix) for prefix in dict.fromkeys(places) if (prefix / "setup.bash").is_file()]
    chosen = [each for each in usable if each[0] and search.distro in ("", each[0])]
    if not chosen:
        return None
    distro, prefix = max(chosen, key=lambda each: (each[1] in own, release_order(each[0])))
    clean = environment_for(search, env, keep_sourced=False)
    clean["CONDA_PREFIX"] = str(prefix)
    clean["PATH"] = os.pathsep.join([str(prefix / "bin"), clean.get("PATH", os.defpath)])
    return Found(
        kind="conda",
        distro=distro,
        prefix=prefix,
        why=f"The environment {prefix} of conda or pixi has it.",
        python=search.python or str(prefix / "bin" / "python3"),
        scripts=(prefix / "setup.bash",),
        environment=clean,
    )


def _conda_distro(prefix: Path) -> str:
    names = (_CONDA_PACKAGE.fullmatch(record.name) for record in prefix.glob("conda-meta/ros*-rclpy-*.json"))
    return next((name[1] for name in names if name), "")


def given(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 in a given workspace or ROS root that contains ROS 2 itself, built from source or unpacked."""
    places = [*(workspace_setup(workspace).parent for workspace in search.workspaces), search.ros_root]
    return _first_built(places, search, env)


def built_from_source(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 of a workspace in the home folder in which ROS 2 itself was built."""
    return _first_built((folder for pattern in _OWN_WORKSPACES for folder in _places(pattern, env)), search, env)


def _first_built(places: Iterable[Path | str], search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the first of these install folders, merged or isolated, that has rclpy and the requested distribution."""
    for install in dict.fromkeys(map(Path, places)):
        package = _rclpy_in(install)
        if not package or not (install / "setup.bash").is_file():
            continue
        distro = distro_of(install) or _conda_distro(install) or search.distro
        if search.distro not in ("", distro):
            continue
        clean = environment_for(search, env, keep_sourced=False)
        return Found(
            kind="built",
            distro=distro,
            prefix=install,
            why=f"ROS 2 was built in {install}.",
            python=search.python or interpreter(package, [install, Path("/usr")], clean) or "python3",
            scripts=(install / "setup.bash",),
            environment=clean,
        )
    return None


def _rclpy_in(install: Path) -> Path | None:
    """Return the folder `rclpy` in an install folder, merged or isolated, or None."""
    return next((found for prefix in (install, install / "rclpy") for found in rclpy_below(prefix)), None)


def distro_of(install: Path) -> str:
    """Return the distribution recorded in an install folder; "" if there is none."""
    for told in (told for pattern in _OF_THE_DISTRO for told in install.glob(pattern)):
        try:
            found = _DISTRO_IN_IT.search(told.read_text(errors="replace"))
        except OSError:
            continue
        if found:
            return found[1]
    return ""


def _places(pattern: str, env: Mapping[str, str]) -> list[Path]:
    """Return the folders that match a pattern, which begins with the home folder or the root."""
    home = env.get("HOME", "")
    if pattern.startswith("~/"):
        return sorted(Path(home).glob(pattern[2:])) if home else []
    path = Path(pattern)
    return sorted(Path("/").glob(str(path.relative_to("/")))) if path.is_absolute() else []


# ── a Python that has rclpy ────────────────────────────────────────────────────────────────────────────────────


def python_with_rclpy(search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 of the given Python, or of the first `python3` on PATH that has
    rclpy, for example from wheels.
    """
    given = shutil.which(search.python, path=env.get("PATH")) if search.python else None
    pythons = [given or search.python] if search.python else pythons_on_path(env)
    deadline_s = time.monotonic() + _PYTHONS_S
    asked = (_asked_for_rclpy(python, search, env) for python in pythons if time.monotonic() < deadline_s)
    return next(filter(None, asked), None)


def pythons_on_path(env: Mapping[str, str]) -> list[str]:
    """Return every `python3` on PATH, in order: one may hide another that has rclpy, as the
    shims of version switchers do.
    """
    # A folder counts once, whatever its name. Programs are not compared: those of environments are links to one file.
    folders = dict.fromkeys(os.path.realpath(entry) for entry in env.get("PATH", os.defpath).split(os.pathsep) if entry)
    return [python for folder in folders if (python := shutil.which("python3", path=folder))][:_MOST_PYTHONS]


def _asked_for_rclpy(python: str, search: Search, env: Mapping[str, str]) -> Found | None:
    """Return the ROS 2 that a Python reports, or None."""
    clean = environment_for(search, env, keep_sourced=False)
    said = _output([python, "-c", _TELL], clean)
    try:
        told = json.loads(said)
    except ValueError:
        return None
    if not told["rclpy"]:
        return None
    packages = Path(told["rclpy"]).parents[1]
    prefix = Path(told["prefix"])
    distro = wheel_distro([packages]) or _conda_distro(prefix)
    if not distro or search.distro not in ("", distro):
        return None
    return Found(
        kind="wheels",
        distro=distro,
        prefix=prefix,
        why=f"{python} has rclpy of {distro}.",
        python=python,
        environment=wheel_environment(clean, prefix, packages),
    )


def wheel_distro(folders: Iterable[Path]) -> str:
    """Return the distribution of the wheels in these folders, from the name `ros-<distro>-rclpy`; "" without wheels."""
    # The folders are only listed: importlib.metadata would open a hundred files.
    for folder in folders:
        for information in folder.glob("ros_*_rclpy-*.dist-info"):
            name = _WHEEL.fullmatch(information.name.split("-")[0])
            if name:
                return name[1].lower()
    return ""


def wheel_environment(env: Mapping[str, str], prefix: Path, site_packages: Path) -> dict[str, str]:
    """Return the environment that the wheels' own start-up hook would set, so that it need not
    start Python a second time.
    """
    libraries = [str(prefix / "lib"), *sorted(str(folder) for folder in site_packages.glob("ros_*.libs"))]
    inherited = [entry for entry in env.get("LD_LIBRARY_PATH", "").split(os.pathsep) if entry]
    return {
        **env,
        "LD_LIBRARY_PATH": os.pathsep.join([*libraries, *inherited]),
        "AMENT_PREFIX_PATH": str(prefix),
        WHEEL_GUARD: "1",
    }


# ── workspaces ─────────────────────────────────────────────────────────────────────────────────────────────────


def workspace_setup(workspace: str) -> Path:
    """Return the setup file of a workspace, which is given by its root, its install folder or that file itself.

    Raises:
        NotFound: if there is none.
    """
    path = Path(workspace).expanduser()
    places = (path, path / "install" / "setup.bash", path / "setup.bash")
    found = next((place for place in places if place.is_file()), None)
    if not found:
        raise NotFound(
            f"The workspace {path} has no install/setup.bash.",
            "Build it (colcon build), or give its root, its install folder or a setup.bash.",
        )
    return found.absolute()


def own_workspace(found: Found) -> list[Path]:
    """Return the setup file of `~/ros2_ws` if that workspace is an overlay of this installation, else an empty list.

    A ROS 2 found by its running processes has their workspaces already.
    """
    setup = Path(found.environment.get("HOME", "/")) / "ros2_ws" / "install" / "setup.bash"
    try:
        stands_on = setup.read_text(errors="replace")
    except OSError:
        return []
    return [setup] if found.kind == "unsourced" and f'"{found.prefix}"' in stands_on else []


# ── common to all ──────────────────────────────────────────────────────────────────────────────────────────────


def environment_for(search: Search, env: Mapping[str, str], *, keep_sourced: bool) -> dict[str, str]:
    """Return a copy of an environment with the requested settings, and with the settings of setup files only if
    `keep_sourced`.
    """
    clean = {name: value for name, value in env.items() if keep_sourced or name not in OF_A_SOURCED_SHELL}
    clean.update(search.env)
    if search.domain_id is not None:
        clean["ROS_DOMAIN_ID"] = str(search.domain_id)
    if search.rmw:
        clean["RMW_IMPLEMENTATION"] = search.rmw
    return clean


def path_entries(env: Mapping[str, str], variable: str) -> list[Path]:
    """Return the entries of a variable such as PATH."""
    return [Path(entry) for entry in env.get(variable, "").split(os.pathsep) if entry]


def _output(words: Sequence[str], env: Mapping[str, str]) -> str:
    """Return the output of a program; "" if it fails or takes too long."""
    try:
        done = subprocess.run(
            words,
            env=dict(env),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_PYTHON_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.decode(errors="replace") if done.returncode == 0 else ""
