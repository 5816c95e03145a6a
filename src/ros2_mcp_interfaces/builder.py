"""Builds interface packages: from directories of definitions to prefixes that ROS 2 can use."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from ros2_mcp_interfaces.cache import content_name, one_builder
from ros2_mcp_interfaces.compile import JOBS, Compiler, find_compiler
from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.generate import TYPESUPPORTS, Generation
from ros2_mcp_interfaces.installation import Installation, find_installation, python_headers
from ros2_mcp_interfaces.package import Package, find_packages
from ros2_mcp_interfaces.syntax import check_syntax

_RUNTIME = (
    *("rosidl_runtime_c", "rosidl_typesupport_c", *TYPESUPPORTS, "rosidl_typesupport_fastrtps_cpp"),
    *("rmw", "rcutils", "fastcdr"),
)
"""Libraries of the installation that generated code may use; the linker drops unused libraries."""

_TELLS_S = 5.0
"""Time between two lines about how many files are compiled."""


def build(directories: Sequence[Path], cache: Path, report: Callable[[str], None]) -> list[Path]:
    """Build the interface packages in `directories`, and return one prefix per package, dependencies first.

    A package that was already built from the same content is taken from `cache`. `report` is called with a line of text
    for each step. Raises `BuildError` with the reason and a hint.

    A prefix has `lib/`, `include/`, `share/` with the definitions and the ament index, and `site-packages/`. To use it,
    put the prefixes in AMENT_PREFIX_PATH and their `site-packages` in PYTHONPATH.
    """
    packages, installation = find_packages(directories), find_installation()
    prefixes: list[Path] = []
    for package in packages:
        prefix = _build_or_reuse(package, installation, Path(cache).absolute(), report)
        installation = installation.with_package(prefix)
        prefixes.append(prefix)
    return prefixes


def finished(directories: Sequence[Path], cache: Path) -> list[Path]:
    """Return the prefixes of the packages that are in the cache, as `build` would make them here. Builds nothing.

    A package that depends on one that is not in the cache is not in the cache either.

    Raises `BuildError` if there is no installation to build against.
    """
    packages, installation = find_packages(directories), find_installation()
    prefixes: list[Path] = []
    for package in packages:
        try:
            prefix = Path(cache).absolute() / content_name(package, installation)
        except BuildError:
            continue
        if prefix.is_dir():
            installation = installation.with_package(prefix)
            prefixes.append(prefix)
    return prefixes


def planned(directories: Sequence[Path], cache: Path) -> list[Path]:
    """Return the prefixes that `build` would give these packages here, built or not.

    Raises `BuildError` if a package depends on one that is not built, or if there is no installation to build against.
    """
    packages, installation = find_packages(directories), find_installation()
    prefixes: list[Path] = []
    for package in packages:
        prefixes.append(Path(cache).absolute() / content_name(package, installation))
        if prefixes[-1].is_dir():
            installation = installation.with_package(prefixes[-1])
    return prefixes


def _build_or_reuse(package: Package, installation: Installation, cache: Path, report: Callable[[str], None]) -> Path:
    if (installation.home / "share" / package.name).is_dir():
        raise BuildError(f"{package.name} is part of the installation {installation.home}", "Leave it out.")
    try:
        name = content_name(package, installation)
    except BuildError:
        check_syntax(package)  # a misspelt line may look like an unknown type: this error is clearer
        raise
    prefix = cache / name
    if not prefix.is_dir():
        check_syntax(package)
        compiler, headers = find_compiler(), python_headers()
        with one_builder(cache, name) as workspace:
            if not prefix.is_dir():
                _Build(package, installation, compiler, headers, workspace).run(report).rename(prefix)
                return prefix
    report(f"{package.name}: already built")
    return prefix


@dataclass(frozen=True)
class _Build:
    """One package being built inside a workspace directory next to its final place."""

    package: Package
    installation: Installation
    compiler: Compiler
    headers: list[Path]
    workspace: Path

    @property
    def prefix(self) -> Path:
        return self.workspace / "prefix"

    @property
    def share(self) -> Path:
        return self.prefix / "share" / self.package.name

    def run(self, report: Callable[[str], None]) -> Path:
        started = time.monotonic()
        package = self.package
        for file in package.files:
            _copy(file, self.share / file.suffix[1:] / file.name)
        if package.manifest.is_file():
            _copy(package.manifest, self.share / package.manifest.name)
        report(f"{package.name}: generating and compiling {len(package.files)} interfaces")
        self._link(self._compiled(report))
        self._write_index()
        report(f"{package.name}: built in {time.monotonic() - started:.1f} s")
        return self.prefix

    def _compiled(self, report: Callable[[str], None]) -> dict[str, list[Path]]:
        """Generate and compile the sources. Return the object files of each library, and of the Python extension
        (`extension`).
        """
        sources = self.workspace / "sources"
        sources.mkdir(exist_ok=True)
        own = [sources / name for name in ("rosidl_generator_c", *TYPESUPPORTS)]
        includes = [*own, *self.installation.include_directories, *self.headers]
        headers = self.prefix / "include" / self.package.name / self.package.name
        objects: dict[str, list[Future[Path]]] = {}
        with ThreadPoolExecutor(JOBS) as pool:  # compiles the first sources while the others are generated
            for made in Generation(self.package, self.installation, self.share, sources).run():
                report(f"{self.package.name}: {made.generator} has generated {len(made.sources)} files")
                for source in made.sources:
                    library = "extension" if ".ep." in source.name else made.generator
                    objects.setdefault(library, []).append(pool.submit(self.compiler.compile, source, includes))
                for path in made.directory.rglob("*"):
                    if path.suffix in (".h", ".py"):
                        target = headers if path.suffix == ".h" else self._modules
                        _copy(path, target / path.relative_to(made.directory))
            self._wait([future for futures in objects.values() for future in futures], report)
        return {library: [future.result() for future in futures] for library, futures in objects.items()}

    def _wait(self, compiling: Sequence[Future[Path]], report: Callable[[str], None]) -> None:
        """Wait until all is compiled, or one file failed; report how far it is every few seconds."""
        told = 0
        while True:
            done, pending = wait(compiling, timeout=_TELLS_S, return_when=FIRST_EXCEPTION)
            failed = next((error for future in done if (error := future.exception())), None)
            if failed:
                for future in pending:
                    future.cancel()
                raise failed
            if not pending:
                return
            if len(done) > told:
                told = len(done)
                report(f"{self.package.name}: {told} of {len(compiling)} files compiled")

    @property
    def _modules(self) -> Path:
        return self.prefix / "site-packages" / self.package.name

    def _link(self, objects: dict[str, list[Path]]) -> None:
        libraries, system = self.prefix / "lib", self.installation.home / "lib"
        libraries.mkdir()
        dependencies = self.installation.dependencies_of(self.package)
        # Built packages are beside this one in the cache, and found by relative paths wherever the cache is.
        built = [prefix.name for prefix in dependencies.values() if prefix in self.installation.built]
        runtime = [system / f"lib{name}.so" for name in _RUNTIME]
        extension = objects.pop("extension")
        for library, compiled in objects.items():
            needed = [prefix / "lib" / f"lib{name}__{library}.so" for name, prefix in dependencies.items()]
            own = sorted(libraries.glob("*.so"))
            search = ["$ORIGIN", *(f"$ORIGIN/../../{name}/lib" for name in built), str(system)]
            target = libraries / f"lib{self.package.name}__{library}.so"
            self.compiler.link(target, [*compiled, *own, *needed, *runtime], search)
        (self._modules / "__init__.py").touch()
        # Type supports are looked up by name at run time. They are loaded here, and so found without LD_LIBRARY_PATH.
        up = "$ORIGIN/../../lib"
        search = [up, *(f"{up}/../../{name}/lib" for name in built), str(system)]
        target = self._modules / f"{self.package.name}_s__rosidl_typesupport_c.so"
        self.compiler.link(target, [*extension, *sorted(libraries.glob("*.so"))], search, keep_all=True)

    def _write_index(self) -> None:
        index = self.prefix / "share" / "ament_index" / "resource_index"
        files = (path for path in self.share.glob("*/*") if path.suffix != ".json")
        interfaces = sorted(path.relative_to(self.share).as_posix() for path in files)
        for resource, content in (("packages", ""), ("rosidl_interfaces", "\n".join(interfaces))):
            (index / resource).mkdir(parents=True)
            (index / resource / self.package.name).write_text(content, encoding="utf-8")


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
