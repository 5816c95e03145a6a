"""Read mesh files named in the robot's description on this machine: each once, with limited triangles."""

from __future__ import annotations

import asyncio
import hashlib
import os
import stat
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from ros2_mcp.model.errors import BadData, RobotError
from ros2_mcp.model.text import named
from ros2_mcp.settings import Settings
from ros2_mcp.view.look import Chunks
from ros2_mcp_common.files import PLAIN

if TYPE_CHECKING:
    from ros2_mcp.world.meshes import PackedMesh

MOST_MESHES = 200
"""Meshes of one description; a humanoid has 60."""
_MOST_TRIANGLES = 120_000
"""Triangles of all meshes together, which a computer without a graphics card rotates smoothly."""
_MOST_OF_ONE = 20_000
_MOST_NAME = 500
_MOST_PACKAGES = 2000
_SUFFIXES = (".stl", ".dae", ".obj")


class MeshFiles:
    """Mesh files that were read: each has a key for fetching it, or a reason why it cannot be shown."""

    def __init__(self, chunks: Chunks, prefixes: Sequence[Path] = ()) -> None:
        self._chunks = chunks
        self._prefixes = prefixes
        self._read: dict[str, Mapping[str, Any] | str] = {}

    async def read(self, names: Sequence[str]) -> Mapping[str, Mapping[str, Any] | str]:
        """Return what a page needs of each mesh in the description, or why the mesh is not drawn."""
        wanted = list(dict.fromkeys(names))
        most = min(_MOST_OF_ONE, _MOST_TRIANGLES // max(len(wanted), 1))
        found: dict[str, Mapping[str, Any] | str] = {}
        for name in wanted[:MOST_MESHES]:
            found[name] = await self._one(name, most)
        self._read = dict(found)
        return {**found, **dict.fromkeys(wanted[MOST_MESHES:], f"only {MOST_MESHES} meshes are drawn")}

    async def _one(self, name: str, most: int) -> Mapping[str, Any] | str:
        known = self._read.get(name)
        if isinstance(known, Mapping) and self._chunks.find(str(known["key"])) is not None:
            return known
        try:
            made = await asyncio.to_thread(_packed, name, most, self._prefixes)
        except RobotError as error:
            return error.message
        except OSError as error:
            return f"it cannot be read: {error.strerror or type(error).__name__}"
        key = hashlib.sha256(made.data).hexdigest()[:32]
        self._chunks.keep(key, made.data, "mesh", most=MOST_MESHES)
        return {
            "key": key,
            "vertices": made.vertices,
            "triangles": made.triangles,
            "low": made.low,
            "step": made.step,
            "coloured": made.has_colours,
        }


def _packed(name: str, most: int, prefixes: Sequence[Path]) -> PackedMesh:
    from ros2_mcp.world.meshes import MOST_BYTES, packed_mesh, parts_of

    path = file_of(name, _prefixes(prefixes))
    # Do not wait for a device or a pipe that a description names as a mesh.
    descriptor = os.open(path, os.O_RDONLY | PLAIN | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as opened:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise BadData("It is not a file.")
        data = opened.read(MOST_BYTES + 1)
    return packed_mesh(parts_of(data, path.suffix), most)


def file_of(name: str, prefixes: Sequence[Path]) -> Path:
    """Return the file on this machine of `package://PACKAGE/PATH` or `file:///PATH`.

    Raises:
        BadData: if the name is not such a path, leads out of its package, or the file does not exist.
    """
    kind, _, rest = name.partition("://")
    if len(name) > _MOST_NAME or kind not in ("package", "file") or "\0" in name:
        raise BadData("Only package:// and file:// addresses are read.")
    parts = PurePosixPath(unquote(rest)).parts
    if ".." in parts or not parts or Path(parts[-1]).suffix.lower() not in _SUFFIXES:
        raise BadData(f"It is not the path of a mesh ({', '.join(_SUFFIXES)}).")
    if kind == "file":
        path = Path(*parts)
        if not path.is_absolute() or not path.is_file():
            raise BadData("It is not on this machine.")
        return path
    package, *inner = parts
    if package == "/" or not inner:
        raise BadData("It names no package.")
    shares = [prefix / "share" / package for prefix in prefixes]
    path = next((share.joinpath(*inner) for share in shares if share.joinpath(*inner).is_file()), None)
    if path is None:
        has_package = any(share.is_dir() for share in shares)
        raise BadData(
            f"The package {named(package)} on this machine has no such file."
            if has_package
            else f"The package {named(package)} is not on this machine."
        )
    return path


def prefixes_of(settings: Settings) -> Sequence[Path]:
    """Return the installation prefixes from the settings."""
    return [*settings.workspaces, *settings.interface_prefixes, settings.ros_root]


def _prefixes(given: Sequence[Path]) -> list[Path]:
    """Return the prefixes in which to look for packages: at or directly below the given folders and those of
    AMENT_PREFIX_PATH and COLCON_PREFIX_PATH, then Python's own.
    """
    listed = [os.environ.get(name, "") for name in ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH")]
    seen = [Path(one) for text in listed for one in text.split(os.pathsep) if one]
    return [*(prefix for one in (*given, *seen) for prefix in _below(one.expanduser())), Path(sys.prefix)]


def _below(folder: Path) -> list[Path]:
    """Return the prefixes at or directly below a folder.

    The folder may be a prefix, an isolated workspace with one prefix per package, or contain several installations.
    """
    if folder.is_file():  # a setup file
        folder = folder.parent
    if (folder / "install").is_dir():
        folder = folder / "install"
    if (folder / "share").is_dir() or not folder.is_dir():
        return [folder]
    return [one for one in sorted(folder.iterdir())[:_MOST_PACKAGES] if (one / "share").is_dir()]
