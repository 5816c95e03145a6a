"""`ros2-mcp view` as its tests start it, and what they ask its page."""

from __future__ import annotations

import json
import os
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.browser import Page
from support.processes import running
from support.rounds import FULL

STOP = "document.getElementById('stop').click()"
PICTURES = os.environ.get("ROS2_MCP_PICTURES")
"""A folder for what the page looked like, to be looked at by a person."""


def text(of: str) -> str:
    """The expression of an element's text."""
    return f"document.querySelector('{of}').textContent"


def choose(panel: str, topic: str) -> str:
    """The expression that chooses a topic in a panel."""
    return (
        f"(select => {{ select.value = {json.dumps(topic)}; select.dispatchEvent(new Event('change')); }})"
        f"(document.querySelector('#{panel} select'))"
    )


def seek(seconds: float) -> str:
    """The expression that shows another time of a recording."""
    return (
        f"(slider => {{ slider.value = '{seconds}'; slider.dispatchEvent(new Event('input')); }})"
        "(document.querySelector('footer input'))"
    )


@contextmanager
def viewing(environment: dict[str, str], *options: str) -> Iterator[str]:
    """The address of a page."""
    command = [sys.executable, "-m", "ros2_mcp", "view", *options]
    with running(environment, *command) as process:
        assert process.stdout
        yield process.stdout.readline().strip()


class Asked:
    """A page without a browser, which asks for panels as the page does; `address` is what `viewing` gives."""

    def __init__(self, address: str) -> None:
        self._at, _, self._token = address.partition("/#")
        self._view = ""

    def shown(self, **panels: str) -> dict[str, Any]:
        """The content of panels, each by the topic chosen in it; what is unchanged is there, too."""
        asked = {"view": self._view, "panels": panels, "wait_ms": 500}
        request = urllib.request.Request(
            f"{self._at}/call",
            json.dumps({"name": "ros2_view_frame", "arguments": asked}).encode(),
            {"origin": self._at, "content-type": "application/json", "x-ros2-mcp-token": self._token},
        )
        with urllib.request.urlopen(request, timeout=20) as answer:
            told = json.load(answer)
        self._view = told["view"]
        return told["panels"]


SIZES = {"wide": (1440, 900), "middle": (820, 1180), "narrow": (390, 1800)}


def pictured(page: Page, name: str, of: str = "") -> None:
    """Keeps what the page, or a part of it, looks like, where that is wanted."""
    if PICTURES:
        page.picture(Path(PICTURES) / f"{name}.jpg", of)


def pictured_in_all_sizes(page: Page, name: str) -> None:
    """The same in three widths and both themes."""
    for size, (width, height) in SIZES.items() if PICTURES else ():
        for theme in ("light", "dark"):
            page.look(width=width, height=height, dark=theme == "dark")
            page.until(f"document.documentElement.dataset.theme === '{theme}'")
            time.sleep(0.5)  # two rounds of the map
            pictured(page, f"{name}-{size}-{theme}")
    page.look()


def complaints(page: Page) -> list[str]:
    """What a page complained of, but for a call for what is no longer shown: a page that asks for nothing for 10 s, as
    on a machine that does not run it, is let go, and begins anew.
    """
    return [said for said in page.complaints if FULL or "404 (Not Found)" not in said]
