"""The input of a build: directories with definitions, their packages, and references between them."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from ros2_mcp_interfaces.errors import BuildError

KINDS = ("msg", "srv", "action")
_NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
PRIMITIVES = frozenset(("bool", "byte", "char", *_NUMBERS, "string", "wstring"))
_PACKAGE_NAME = re.compile(r"[a-z](_?[a-z0-9])*")
_INTERFACE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")


class LeftOut(NamedTuple):
    """A definition that is not built, and why, as a sentence with a hint."""

    file: Path
    why: str


@dataclass(frozen=True)
class Reference:
    """A field of a message type that is defined elsewhere: `package`/msg/`type_name`."""

    file: Path
    line: int
    field: str
    package: str
    type_name: str

    def __str__(self) -> str:
        return f'{self.file} line {self.line}: field "{self.field}" is a {self.package}/{self.type_name}'


@dataclass(frozen=True)
class Package:
    """One interface package: its name, directory, definition files (absolute) and their references."""

    name: str
    root: Path
    files: tuple[Path, ...]
    references: tuple[Reference, ...]

    @property
    def manifest(self) -> Path:
        """Its package.xml, which may be missing."""
        return self.root / "package.xml"

    @property
    def messages(self) -> list[str]:
        """The names of the messages that this package defines."""
        return [file.stem for file in self.files if file.suffix == ".msg"]


def find_packages(directories: Sequence[Path]) -> list[Package]:
    """Return the interface packages in the given directories, each after the packages that it refers to.

    A directory is a package, or a folder (such as a workspace's `src`) with packages somewhere below it. Raises
    `BuildError` for a directory without definitions, two packages of one name, and cycles.
    """
    packages: dict[str, Package] = {}
    for root in (root for directory in directories for root in _package_roots(Path(directory).absolute())):
        package = _read_package(root)
        first = packages.setdefault(package.name, package)
        if first.root.resolve() != root.resolve():
            raise BuildError(f"two packages are named {package.name}: {first.root} and {root}")
    ordered: dict[str, Package] = {}

    def place(package: Package, path: tuple[str, ...]) -> None:
        if package.name in path:
            raise BuildError(f"packages refer to each other in a circle: {' -> '.join((*path, package.name))}")
        for name in sorted({reference.package for reference in package.references} - {package.name}):
            if name in packages and name not in ordered:
                place(packages[name], (*path, package.name))
        ordered[package.name] = package

    for package in packages.values():
        if package.name not in ordered:
            place(package, ())
    return list(ordered.values())


def left_out(directories: Sequence[Path]) -> list[LeftOut]:
    """Return the definitions below these directories that are skipped although others of their package are built.

    Skipped are `.idl` files (unless a `.msg`, `.srv` or `.action` of the same name lies beside them: they were
    generated from it), definitions with a field named like a Python keyword, and the messages that contain those.
    """
    advice = "IDL is not built here: write it as .msg, or build its package with colcon."
    found = [LeftOut(file, advice) for file in _idl_files(directories)]
    for root in (root for directory in directories for root in _package_roots(Path(directory).absolute())):
        files = _definition_files(root)
        spoilt = _spoilt(files, _read_package(root).name)
        found += [LeftOut(file, why) for file, why in spoilt.items() if len(spoilt) < len(files)]
    return found


def _idl_files(directories: Sequence[Path]) -> list[Path]:
    found = sorted(file for directory in directories for file in Path(directory).absolute().rglob("*.idl"))
    return [file for file in found if not any(file.with_suffix(f".{kind}").is_file() for kind in KINDS)]


def _spoilt(files: Sequence[Path], package: str) -> Mapping[Path, str]:
    """Return the definitions whose generated Python code could not be imported, each with the reason.

    The generator turns a field `from` into an attribute `from`, which is a syntax error.
    """
    found: dict[Path, str] = {}
    for file in files:
        for number, line in enumerate(read_text(file).splitlines(), start=1):
            words = line.split("#", 1)[0].split()
            name = words[1].partition("=")[0] if len(words) > 1 else ""
            if keyword.iskeyword(name):
                found.setdefault(file, f'line {number}: "{name}" is a word of the Python language. Rename the field.')
    while True:  # until no further definition contains a skipped one
        names = {file.stem for file in found if file.suffix == ".msg"}
        more = {
            file: f'line {reference.line}: "{reference.field}" is a {reference.type_name}, which is left out.'
            for file in files
            if file not in found
            for reference in _references(file, package)
            if reference.package == package and reference.type_name in names
        }
        if not more:
            return found
        found |= more


def _package_roots(directory: Path) -> list[Path]:
    if not directory.is_dir():
        raise BuildError(f"{directory} is not a directory", "Give the directory of an interface package.")
    if _definition_files(directory):
        return [directory]
    roots = sorted({file.parent.parent for kind in KINDS for file in directory.rglob(f"{kind}/*.{kind}")})
    if not roots:
        idl = ", and .idl files are not built here" if _idl_files([directory]) else ""
        raise BuildError(
            f"no .msg, .srv or .action files in {directory}{idl}",
            "An interface package keeps them in folders named msg, srv and action.",
        )
    return roots


def _definition_files(root: Path) -> list[Path]:
    patterns = [pattern for kind in KINDS for pattern in (f"{kind}/*.{kind}", f"*.{kind}")]
    return [file for pattern in patterns for file in sorted(root.glob(pattern))]


def _read_package(root: Path) -> Package:
    manifest, name = root / "package.xml", root.name
    if manifest.is_file():
        try:
            name = (ElementTree.parse(manifest).findtext("name") or "").strip()
        except ElementTree.ParseError as error:
            raise BuildError(f"{manifest} is not valid XML: {error}") from error
    if not _PACKAGE_NAME.fullmatch(name):
        raise BuildError(
            f'"{name}" ({manifest if manifest.is_file() else root}) is not a valid package name',
            "Names begin with a letter and have lower case letters, digits and single underscores only.",
        )
    every = _definition_files(root)
    spoilt = _spoilt(every, name)
    files = tuple(file for file in every if file not in spoilt) or tuple(every)
    for file in files:
        if not _INTERFACE_NAME.fullmatch(file.stem):
            raise BuildError(
                f'{file}: "{file.stem}" is not a valid interface name',
                "Names begin with a capital letter and have letters and digits only, as in NavigateTo.",
            )
    return Package(name, root, files, tuple(reference for file in files for reference in _references(file, name)))


def _references(file: Path, package: str) -> Iterator[Reference]:
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        base = re.split(r"[\[<]", words[0])[0] if len(words) > 1 else ""
        if base and base not in PRIMITIVES:
            owner, _, type_name = base.rpartition("/")
            yield Reference(file, number, words[1], owner or package, type_name)


def read_text(file: Path) -> str:
    """Return the text of a definition file. Raises `BuildError` if it is not UTF-8."""
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BuildError(f"{file} is not UTF-8 text: {error}") from error
