"""Generates C, C++ and Python source from definitions, with the generators of the ROS 2 installation."""

# pyright: basic, reportMissingImports=false

from __future__ import annotations

import contextlib
import importlib
import io
import json
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.installation import Installation
from ros2_mcp_interfaces.package import Package

TYPESUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
_STEPS: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    ("rosidl_generator_c", "generate_c", ()),
    ("rosidl_typesupport_fastrtps_c", "generate_typesupport_fastrtps_c", ()),
    ("rosidl_typesupport_introspection_c", "generate_c", ()),
    ("rosidl_typesupport_c", "generate_c", (TYPESUPPORTS,)),
    ("rosidl_generator_py", "generate_py", (["rosidl_typesupport_c"],)),
)
"""For each generator: its module, its function, and the function's arguments after the arguments file; in linking
order.
"""


@dataclass(frozen=True)
class Generated:
    """The output of one generator: `sources` become the library `lib<package>__<generator>`."""

    generator: str
    directory: Path
    sources: list[Path]


@dataclass(frozen=True)
class Generation:
    """Generates one package: .idl files and type descriptions in `share`, source code in `sources`."""

    package: Package
    installation: Installation
    share: Path
    sources: Path

    def run(self) -> Iterator[Generated]:
        """Yield the output of each generator as soon as it is there, in the order in which to link the results.

        Raises `BuildError` if a generator refuses the definitions.
        """
        # Imported here: without the generators of the ROS installation, this package must still start, and report that.
        from rosidl_adapter import convert_to_idl

        texts = [Path(file.suffix[1:], file.name) for file in self.package.files]
        with self._diagnosed("rosidl_adapter"):
            interfaces = [Path(convert_to_idl(self.share, self.package.name, text, self.share)) for text in texts]
        self._write_descriptions(interfaces)
        for generator, function, arguments in _STEPS:
            directory = self.sources / generator / self.package.name
            generate = getattr(importlib.import_module(generator), function)
            with self._diagnosed(generator):
                generate(str(self._arguments(generator, directory, interfaces)), *arguments)
            self._write_visibility_header(generator, directory)
            found = sorted(path for path in directory.rglob("*") if path.suffix in (".c", ".cpp"))
            yield Generated(generator, directory, found)

    def _write_descriptions(self, interfaces: list[Path]) -> None:
        """Write the type descriptions with their hashes. Their generator reads the descriptions of all contained types,
        also from other packages.
        """
        from rosidl_generator_type_description import generate_type_hash

        shares = [prefix / "share" for prefix in reversed(self.installation.prefixes)]
        others = {path.name: path for share in shares for path in share.iterdir() if (path / "msg").is_dir()}
        file = self._arguments("rosidl_generator_type_description", self.share, interfaces)
        arguments = json.loads(file.read_text(encoding="utf-8"))
        arguments["include_paths"] = [f"{name}:{path}" for name, path in others.items()]
        file.write_text(json.dumps(arguments), encoding="utf-8")
        with self._diagnosed("rosidl_generator_type_description"):
            generate_type_hash(str(file))

    def _arguments(self, generator: str, output: Path, interfaces: list[Path]) -> Path:
        """Write the file of arguments that a generator reads, as CMake would, and return its path."""
        relative = [interface.relative_to(self.share) for interface in interfaces]
        descriptions = [f"{path.as_posix()}:{(self.share / path).with_suffix('.json')}" for path in relative]
        arguments = {
            "package_name": self.package.name,
            "output_dir": str(output),
            "template_dir": str(self._resources(generator)),
            "idl_tuples": [f"{self.share}:{path.as_posix()}" for path in relative],
            "type_description_tuples": descriptions,
            "ros_interface_files": [str(self.share / file.suffix[1:] / file.name) for file in self.package.files],
            "ros_interface_dependencies": [],
            "target_dependencies": [],
        }
        file = self.sources / f"{generator}.json"
        file.write_text(json.dumps(arguments), encoding="utf-8")
        return file

    def _write_visibility_header(self, generator: str, directory: Path) -> None:
        """Write the header that CMake would configure, and that the generated code includes."""
        name = f"{generator}__visibility_control.h"
        template = self._resources(generator) / f"{name}.in"
        if template.is_file():
            text = template.read_text(encoding="utf-8").replace("@PROJECT_NAME@", self.package.name)
            text = text.replace("@PROJECT_NAME_UPPER@", self.package.name.upper())
            (directory / "msg").mkdir(parents=True, exist_ok=True)
            (directory / "msg" / name).write_text(text, encoding="utf-8")

    def _resources(self, generator: str) -> Path:
        return self.installation.home / "share" / generator / "resource"

    @contextlib.contextmanager
    def _diagnosed(self, step: str) -> Generator[None]:
        """Keep the generators from printing, and raise their failures as `BuildError` with their output."""
        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                yield
        except Exception as error:  # the generators raise many types of errors
            output = "\n".join(said.getvalue().splitlines()[-5:])  # the cause comes last
            message = f"{self.package.name}: {step} failed: {type(error).__name__}: {error}"
            raise BuildError(message, output) from error
