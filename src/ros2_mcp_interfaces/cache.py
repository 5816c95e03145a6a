"""Finished packages on disk: one directory per content, complete or not there at all."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import sysconfig
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.installation import Installation, check_references
from ros2_mcp_interfaces.package import Package

RECIPE = 1  # to be raised when the way of building changes, so that older results are not used


def default_cache() -> Path:
    """Where finished packages are kept unless told otherwise."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ros2-mcp" / "interfaces"


def content_name(package: Package, installation: Installation) -> str:
    """`<package>-<16 hex digits>`, the same whenever building would give the same result.

    Raises `BuildError` when the package refers to a type that is not there.
    """
    descriptions = check_references(package, installation)
    digest = hashlib.sha256()
    platform = (str(RECIPE), str(sysconfig.get_config_var("SOABI")), _numpy_major())
    for part in (*platform, *installation.versions, *_built(package, installation)):
        digest.update(part.encode() + b"\0")
    manifest = package.root / "package.xml"
    own = [*package.files, manifest] if manifest.is_file() else package.files
    for file in (*own, *descriptions):
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)}\0".encode() + content)
    return f"{package.name}-{digest.hexdigest()[:16]}"


def _built(package: Package, installation: Installation) -> list[str]:
    """The content names of those dependencies that were built, too: the result holds their paths."""
    dependencies = installation.dependencies_of(package).values()
    return [prefix.name for prefix in dependencies if prefix in installation.built]


@contextmanager
def one_builder(cache: Path, name: str) -> Generator[Path]:
    """A new directory to build `name` in, while every other process that wants to build it waits.

    The directory is removed afterwards, and so are those that a killed builder left behind.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        lock = (cache / f".{name}.lock").open("w")
    except OSError as error:
        raise BuildError(f"cannot write to the cache {cache}: {error}", "Choose another with --cache.") from error
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _remove_leftovers(cache, name)
        workspace = Path(tempfile.mkdtemp(prefix=f".{name}.", dir=cache))
        try:
            yield workspace
        finally:
            shutil.rmtree(workspace, ignore_errors=True)


def _remove_leftovers(cache: Path, name: str) -> None:
    for path in cache.glob(f".{name}.*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)


def _numpy_major() -> str:
    try:
        return metadata.version("numpy").split(".")[0]
    except metadata.PackageNotFoundError:
        return "none"
