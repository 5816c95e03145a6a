"""The ROS 2 installation that packages are built against: its generators, libraries, headers and packages."""

# pyright: basic, reportMissingImports=false

from __future__ import annotations

import difflib
import os
import re
import sys
import sysconfig
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.package import Package, Reference

GENERATORS = (
    "rosidl_adapter",
    "rosidl_generator_type_description",
    "rosidl_generator_c",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_c",
    "rosidl_generator_py",
)
# Packages whose types the generators add to every service and action, in addition to its definition.
_IMPLIED = {
    ".srv": ("builtin_interfaces", "service_msgs"),
    ".action": ("action_msgs", "builtin_interfaces", "service_msgs", "unique_identifier_msgs"),
}
# Types without a package name, as in ROS 1.
_OF_ROS_1 = {"Header": "std_msgs/Header", "time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}

_VERSION = re.compile(r"<version>\s*([^<\s]+)")
_WHEELS_HINT = (
    "Interfaces are built against ROS 2 wheels, which are the extra 'jazzy' of ros2-mcp. "
    "For a normal ROS 2 installation use 'colcon build' and source the workspace."
)


@dataclass(frozen=True)
class Installation:
    """A ROS 2 installation: `home` has the generators, `built` are the prefixes of packages that were built on top of
    it.
    """

    home: Path
    built: tuple[Path, ...] = ()

    def with_package(self, prefix: Path) -> Installation:
        """Return this installation with one more package, which hides packages of the same name below it."""
        return Installation(self.home, (prefix, *self.built))

    @property
    def prefixes(self) -> tuple[Path, ...]:
        """The prefixes in which packages are searched for, in order."""
        return (*self.built, self.home)

    @property
    def include_directories(self) -> list[Path]:
        """The include directory of each installed package, and the common include directory."""
        packages = [path for prefix in self.prefixes for path in sorted((prefix / "include").iterdir())]
        return [*(path for path in packages if path.is_dir()), self.home / "include"]

    @cached_property
    def versions(self) -> list[str]:
        """The name and version of each generator, which determine the generated code."""
        manifests = {name: self.home / "share" / name / "package.xml" for name in GENERATORS}
        found = {name: _VERSION.search(file.read_text(encoding="utf-8")) for name, file in manifests.items()}
        return [f"{name} {version[1] if version else 'unknown'}" for name, version in found.items()]

    def prefix_of(self, package: str) -> Path | None:
        """Return the prefix with the interfaces of a package; None if it is not installed."""
        found = (prefix for prefix in self.prefixes if (prefix / "share" / package / "msg").is_dir())
        return next(found, None)

    def description_of(self, reference: Reference) -> Path:
        """Return the file that describes a type and all types that it contains.

        Raises `BuildError` if the package or the type is not installed.
        """
        prefix = self.prefix_of(reference.package)
        if prefix is None:
            raise BuildError(
                f"{reference}, but there is no package {reference.package}",
                f"Build {reference.package} in the same call, or install it into this environment.",
            )
        folder = prefix / "share" / reference.package / "msg"
        description = folder / f"{reference.type_name}.json"
        if not description.is_file():
            raise _unknown_type(reference, [path.stem for path in folder.glob("*.json")])
        return description

    def dependencies_of(self, package: Package) -> dict[str, Path]:
        """Return the prefixes of all packages whose libraries this package needs, by package name. Raises `BuildError`
        if one is missing.
        """
        names = {reference.package for reference in package.references} - {package.name}
        names.update(name for file in package.files for name in _IMPLIED.get(file.suffix, ()))
        prefixes = {name: prefix for name in sorted(names) if (prefix := self.prefix_of(name))}
        if missing := sorted(names - prefixes.keys()):
            raise BuildError(f"{package.name} needs {', '.join(missing)}, not in {self.home}", _WHEELS_HINT)
        return prefixes


def check_references(package: Package, installation: Installation) -> list[Path]:
    """Return the descriptions of all types from other packages. Raises `BuildError` for unknown types."""
    descriptions: set[Path] = set()
    for reference in package.references:
        if reference.package != package.name:
            descriptions.add(installation.description_of(reference))
        elif reference.type_name not in package.messages:
            raise _unknown_type(reference, package.messages)
    return sorted(descriptions)


def find_installation() -> Installation:
    """Return the installation of this Python, or else the first installation in AMENT_PREFIX_PATH. Raises `BuildError`
    if generators are missing.
    """
    sourced = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    for home in (Path(sys.prefix), *sourced):
        if all((home / "share" / name / "package.xml").is_file() for name in GENERATORS):
            return Installation(home)
    if os.environ.get("AMENT_PREFIX_PATH") and find_spec("rclpy"):
        raise BuildError(
            "this ROS 2 installation has no interface generators that can be used here",
            "For a normal ROS 2 installation use 'colcon build' and source the workspace.",
        )
    raise BuildError(f"no ROS 2 installation with interface generators at {sys.prefix}", _WHEELS_HINT)


def python_headers() -> list[Path]:
    """Return the directories with the C headers of Python and NumPy. Raises `BuildError` if they are missing."""
    python = Path(sysconfig.get_paths()["include"])
    if not (python / "Python.h").is_file():
        name = f"python{sys.version_info.major}.{sys.version_info.minor}-dev"
        raise BuildError(f"the C headers of Python are missing ({python}/Python.h)", f"sudo apt install {name}")
    try:
        import numpy
    except ImportError as error:
        raise BuildError("NumPy is missing", f"{sys.executable} -m pip install numpy") from error
    return [python, Path(numpy.get_include())]


def _unknown_type(reference: Reference, names: list[str]) -> BuildError:
    near = difflib.get_close_matches(reference.type_name, names, n=1)
    suggestion = _OF_ROS_1.get(reference.type_name) or (f"{reference.package}/{near[0]}" if near else "")
    hint = f"Did you mean {suggestion}?" if suggestion else ""
    return BuildError(f"{reference}, but {reference.package} has no message {reference.type_name}", hint)
