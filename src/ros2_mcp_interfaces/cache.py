"""Finished packages on disk: one directory per content, either complete or absent."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import sysconfig
from collections.abc import Generator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from ros2_mcp_interfaces.errors import BuildError
from ros2_mcp_interfaces.installation import Installation, check_references
from ros2_mcp_interfaces.package import Package

RECIPE = 1  # raise it when the build changes, so that older results are not used


def default_cache() -> Path:
    """Return the default folder of finished packages."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ros2-mcp" / "interfaces"


def content_name(package: Package, installation: Installation) -> str:
    """Return `<package>-<16 hex digits>`, the same whenever building would give the same result.

    Raises `BuildError` if the package refers to an unknown type.
    """
    descriptions = check_references(package, installation)
    try:
        numpy_major = metadata.version("numpy").split(".")[0]  # a new major version breaks compiled extensions
    except metadata.PackageNotFoundError:
        numpy_major = "none"
    dependencies = installation.dependencies_of(package).values()
    # The result also contains the paths of dependencies that were built.
    built = [prefix.name for prefix in dependencies if prefix in installation.built]
    digest = hashlib.sha256()
    for part in (str(RECIPE), str(sysconfig.get_config_var("SOABI")), numpy_major, *installation.versions, *built):
        digest.update(part.encode() + b"\0")
    manifest = [package.manifest] if package.manifest.is_file() else []
    for file in (*package.files, *manifest, *descriptions):
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)}\0".encode() + content)
    return f"{package.name}-{digest.hexdigest()[:16]}"


@contextmanager
def one_builder(cache: Path, name: str) -> Generator[Path]:
    """Within this context, the directory to build `name` in; other processes that want to build it wait.

    The directory is removed if the build is finished or fails. One that a killed or interrupted builder leaves is the
    next one's, with the object files that were compiled: its name stands for the same sources.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        lock = (cache / f".{name}.lock").open("w")
    except OSError as error:
        raise BuildError(f"cannot write to the cache {cache}: {error}", "Choose another with --cache.") from error
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the system releases it when the process ends, however it ends
        # Beside its final place, so that the finished package is moved there by a rename: complete, or not at all.
        workspace = cache / f".{name}.part"
        workspace.mkdir(exist_ok=True)
        shutil.rmtree(workspace / "prefix", ignore_errors=True)
        try:
            yield workspace
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException:
            shutil.rmtree(workspace, ignore_errors=True)
            raise
        shutil.rmtree(workspace, ignore_errors=True)
