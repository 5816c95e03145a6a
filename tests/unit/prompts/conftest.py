"""A robot that is not there: base prompts need it only to name what is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.prompts.mistakes import Mistake
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings

MakeFolder = Callable[..., tuple[PromptFolder, list[Mistake]]]


@pytest.fixture
def robot() -> Robot:
    return Robot(Bridge(lambda: start_carrier(Settings())))


@pytest.fixture
def make_folder(tmp_path: Path) -> MakeFolder:
    """Write files, `make_folder({"hello.md": "---…"})`, and get the folder and the list its mistakes go to."""

    def make(files: dict[str, str], **options: frozenset[str]) -> tuple[PromptFolder, list[Mistake]]:
        for name, text in files.items():
            (tmp_path / name).write_text(text, encoding="utf-8")
        told: list[Mistake] = []
        return PromptFolder(tmp_path, told.append, **options), told

    return make
