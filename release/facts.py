"""What all manifests say of this project: read from `pyproject.toml`, and from nowhere else."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NOBODY = "OWNER"
"""Stands in `[tool.release]` until somebody publishes this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """`owner` is the account that the repository belongs to, `author` the name that manifests show."""

    name: str
    version: str
    description: str
    licence: str
    requires_python: str
    keywords: tuple[str, ...]
    owner: str
    author: str

    @property
    def url(self) -> str:
        """The repository's."""
        return f"https://github.com/{self.owner}/{self.name}"

    @property
    def registry_name(self) -> str:
        """The name in the MCP registry, whose first part is proved by logging in as the owner."""
        return f"io.github.{self.owner}/{self.name}"

    @property
    def email(self) -> str:
        """An address that a ROS package must have; the one that the account has without telling another."""
        return f"{self.owner}@users.noreply.github.com"


def read_facts(root: Path = ROOT) -> Facts:
    """The facts of a checkout."""
    toml = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")
    tables = toml.loads((root / "pyproject.toml").read_text("utf-8"))
    project, release = tables["project"], tables["tool"]["release"]
    return Facts(
        name=project["name"],
        version=project["version"],
        description=project["description"],
        licence=project["license"],
        requires_python=project["requires-python"],
        keywords=tuple(project["keywords"]),
        owner=release["owner"],
        author=release["author"],
    )
