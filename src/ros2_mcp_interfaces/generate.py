"""Turns definitions into C, C++ and Python source with the generators of the ROS 2 installation."""

# pyright: basic, reportMissingImports=false

from __future__ import annotations

import contextlib
import importlib
import io
import json
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.installation import Installation
from ros2_mcp_interfaces.package import Package

TYPESUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]


@dataclass(frozen=True)
class Generated:
    """What one generator made: `sources` become the library `lib<package>__<generator>`."""

    generator: str
    directory: Path
    sources: list[Path]


@dataclass(frozen=True)
class Generation:
    """Generates one package: .idl files and type descriptions into `share`, source code into `sources`."""

    package: Package
    installation: Installation
    share: Path
    sources: Path

    def run(self) -> Iterator[Generated]:
        """Yields what each generator made as soon as it is there, in the order in which to link the results.

        Raises `BuildError` when a generator refuses the definitions.
        """
        interfaces = self._write_idl()
        self._write_descriptions(interfaces)
        for generator, arguments in _STEPS:
            directory = self.sources / generator / self.package.name
            generate = _function_of(generator)
            with _diagnosed(f"{self.package.name}: {generator}"):
                generate(str(self._arguments(generator, directory, interfaces)), *arguments)
            _write_visibility_header(self.installation.home, generator, self.package.name, directory)
            found = sorted(path for path in directory.rglob("*") if path.suffix in (".c", ".cpp"))
            yield Generated(generator, directory, found)

    def _write_idl(self) -> list[Path]:
        from rosidl_adapter import convert_to_idl

        texts = [self.share / file.suffix[1:] / file.name for file in self.package.files]
        with _diagnosed(f"{self.package.name}: rosidl_adapter"):
            return [
                Path(convert_to_idl(self.share, self.package.name, text.relative_to(self.share), self.share))
                for text in texts
            ]

    def _write_descriptions(self, interfaces: list[Path]) -> None:
        from rosidl_generator_type_description import generate_type_hash

        shares = [prefix / "share" for prefix in reversed(self.installation.prefixes)]
        others = {path.name: path for share in shares for path in share.iterdir() if (path / "msg").is_dir()}
        file = self._arguments("rosidl_generator_type_description", self.share, interfaces)
        arguments = json.loads(file.read_text(encoding="utf-8"))
        arguments["include_paths"] = [f"{name}:{path}" for name, path in others.items()]
        file.write_text(json.dumps(arguments), encoding="utf-8")
        with _diagnosed(f"{self.package.name}: rosidl_generator_type_description"):
            generate_type_hash(str(file))

    def _arguments(self, generator: str, output: Path, interfaces: list[Path]) -> Path:
        relative = [interface.relative_to(self.share) for interface in interfaces]
        arguments = {
            "package_name": self.package.name,
            "output_dir": str(output),
            "template_dir": str(self.installation.home / "share" / generator / "resource"),
            "idl_tuples": [f"{self.share}:{path.as_posix()}" for path in relative],
            "type_description_tuples": [
                f"{path.as_posix()}:{(self.share / path).with_suffix('.json')}" for path in relative
            ],
            "ros_interface_files": [str(self.share / file.suffix[1:] / file.name) for file in self.package.files],
            "ros_interface_dependencies": [],
            "target_dependencies": [],
        }
        file = self.sources / f"{generator}.json"
        file.write_text(json.dumps(arguments), encoding="utf-8")
        return file


_STEPS: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("rosidl_generator_c", ()),
    ("rosidl_typesupport_fastrtps_c", ()),
    ("rosidl_typesupport_introspection_c", ()),
    ("rosidl_typesupport_c", (TYPESUPPORTS,)),
    ("rosidl_generator_py", (["rosidl_typesupport_c"],)),
)
_FUNCTIONS = {
    "rosidl_typesupport_fastrtps_c": "generate_typesupport_fastrtps_c",
    "rosidl_generator_py": "generate_py",
}


def _function_of(generator: str) -> Callable[..., Any]:
    return getattr(importlib.import_module(generator), _FUNCTIONS.get(generator, "generate_c"))


def _write_visibility_header(home: Path, generator: str, package: str, directory: Path) -> None:
    name = f"{generator}__visibility_control.h"
    template = home / "share" / generator / "resource" / f"{name}.in"
    if template.is_file():
        text = template.read_text(encoding="utf-8")
        text = text.replace("@PROJECT_NAME@", package).replace("@PROJECT_NAME_UPPER@", package.upper())
        (directory / "msg").mkdir(parents=True, exist_ok=True)
        (directory / "msg" / name).write_text(text, encoding="utf-8")


@contextlib.contextmanager
def _diagnosed(step: str) -> Generator[None]:
    """Keeps the generators from printing, and turns their failures into `BuildError` with what they said."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            yield
    except Exception as error:  # the generators raise errors of many kinds
        output = "\n".join(said.getvalue().splitlines()[-5:])
        raise BuildError(f"{step} failed: {type(error).__name__}: {error}", output) from error
