"""The way in which this program was installed and started: the commands that it suggests to users depend on this.

The package is on no index yet, so "pip install ros2-mcp" would not work; and Debian and Ubuntu refuse a bare pip.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote, urlsplit

from ros2_mcp.model.shell import typed

PROJECT = "ros2-mcp"
# Names of folders in the caches of uv and pipx, whose content is temporary.
_OF_UV_CACHE = re.compile(r"(?:archive|builds|environments)-v\d+")

Way = Literal["uv run", "uvx", "uv tool", "uv pip", "pipx run", "pipx", "pip", "system pip"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """The origin of this installation: `source` is its folder or address, or "" for an index; `editable`: installed as
    a link to it.
    """

    way: Way
    prefix: Path
    python: str
    source: str = ""
    editable: bool = False

    @property
    def lasts(self) -> bool:
        """Whether the environment is permanent; that of a cache is not."""
        return self.way not in ("uvx", "pipx run")

    def requirement(self, extra: str = "") -> str:
        """Return the requirement for an installer: a folder, an address, or the name on an index."""
        extras = f"[{extra}]" if extra else ""
        if not self.source:
            return PROJECT + extras
        return self.source + extras if Path(self.source).is_absolute() else f"{PROJECT}{extras} @ {self.source}"

    def installing(self, extra: str) -> str:
        """Return the shell command that adds the extra to this installation."""
        requirement = typed([self.requirement(extra)])
        python = typed([self.python])
        editable = "--editable " if self.editable else ""
        own = "~/.ros2-mcp"
        return {
            "uv run": f"uv run --project {typed([self.source])} --extra {extra} ros2-mcp doctor",
            "uvx": f"uvx --from {requirement} ros2-mcp doctor",
            "uv tool": f"uv tool install --force {editable}{requirement}",
            "uv pip": f"uv pip install --python {python} {editable}{requirement}",
            "pipx run": f"pipx run --spec {requirement} ros2-mcp doctor",
            "pipx": f"pipx install --force {editable}{requirement}",
            "pip": f"{python} -m pip install {editable}{requirement}",
            # Debian and Ubuntu do not let pip change anything outside of a virtual environment.
            "system pip": f"python3 -m venv {own} && {own}/bin/pip install {requirement} && {own}/bin/ros2-mcp doctor",
        }[self.way]

    def reinstalling(self, extra: str) -> str:
        """Return the shell command that restores missing files of the extra's packages."""
        if self.way == "uv run":
            return f"uv sync --project {typed([self.source])} --extra {extra} --inexact --reinstall"
        if self.way == "uv pip":
            return f"{self.installing(extra)} --reinstall"
        return f"{self.installing(extra)} --force-reinstall" if self.way == "pip" else self.installing(extra)


def own_provenance(env: Mapping[str, str] = os.environ) -> Provenance:
    """Return how the running program was installed, as far as its environment shows."""
    prefix = Path(sys.prefix)
    source, editable = _origin()
    way = _way(prefix, Path(source) if editable and Path(source).is_absolute() else None, env)
    return Provenance(way=way, prefix=prefix, python=sys.executable, source=source, editable=editable)


def _origin() -> tuple[str, bool]:
    """Return the folder or address of the installation (PEP 610), and whether it is a link."""
    try:
        text = distribution(PROJECT).read_text("direct_url.json")
    except PackageNotFoundError:
        text = None
    if not text:
        return "", False
    told: dict[str, Any] = json.loads(text)
    url = str(told["url"])
    if url.startswith("file:"):
        folder = unquote(urlsplit(url).path)
        return folder.lstrip("/") if sys.platform == "win32" else folder, bool(told.get("dir_info", {}).get("editable"))
    version_control: dict[str, str] = told.get("vcs_info", {})
    return (f"{version_control['vcs']}+{url}" if version_control else url), False


def _way(prefix: Path, checkout: Path | None, env: Mapping[str, str]) -> Way:
    real_parts = prefix.resolve().parts
    if any(_OF_UV_CACHE.fullmatch(part) for part in real_parts):
        return "uvx"
    if (prefix / "uv-receipt.toml").is_file():
        return "uv tool"
    if (prefix / "pipx_metadata.json").is_file():
        return "pipx run" if ".cache" in real_parts else "pipx"
    if prefix == Path(sys.base_prefix):
        managed = Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED"
        return "system pip" if managed.is_file() else "pip"
    settings = prefix / "pyvenv.cfg"
    made_by_uv = settings.is_file() and re.search(r"^uv = ", settings.read_text("utf-8"), re.MULTILINE)
    if not made_by_uv:
        return "pip"
    own = env.get("UV_PROJECT_ENVIRONMENT") or ".venv"
    return "uv run" if checkout and checkout / own == prefix else "uv pip"


def launch_command(provenance: Provenance, extra: str, env: Mapping[str, str] = os.environ) -> list[str]:
    """Return the command by which a client starts this program, with permanent absolute paths."""
    requirement = provenance.requirement(extra)
    if provenance.way == "uvx":
        # uv passes its own path to the programs that it runs.
        uv = env.get("UV") or shutil.which("uv") or "uv"
        python = f"{sys.version_info.major}.{sys.version_info.minor}"
        return [uv, "tool", "run", "--python", python, "--from", requirement, PROJECT]
    if provenance.way == "pipx run":
        return [shutil.which("pipx") or "pipx", "run", "--spec", requirement, PROJECT]
    beside = Path(provenance.python).with_name(f"{PROJECT}.exe" if sys.platform == "win32" else PROJECT)
    return [str(beside)] if beside.is_file() else [provenance.python, "-m", "ros2_mcp"]
