"""The client of the tour, and its transcript: each step prints the call and the answer."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import base64
import json
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from mcp import Client
from mcp.types import CallToolResult, ImageContent

from ros2_mcp.mcp.server import STRUCTURED

_BOLD, _DIM, _GREEN, _RED, _END = "\033[1m", "\033[2m", "\033[32m", "\033[31m", "\033[0m"


class StepFailed(Exception):
    """A tool returned an error after which the tour cannot continue."""


class Tour:
    """One client with a transcript; each step prints the call and the answer."""

    client: Client

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._started = time.monotonic()
        self._pictures = 0
        self._is_over = False
        self.transcript: list[dict[str, Any]] = []
        self.failures: list[str] = []

    def say(self, text: str) -> None:
        """Print a heading."""
        self.transcript.append({"say": text})
        print(f"\n{_paint(_BOLD, text)}", flush=True)

    def show(self, text: str) -> None:
        """Print a line of results."""
        self.transcript.append({"show": text})
        print(f"  {text}", flush=True)

    def verify(self, claim: str, holds: bool) -> None:
        """Print a claim that the tour has checked. If it does not hold, the tour fails."""
        if not holds:
            self.failures.append(claim)
        self.show(_paint(_GREEN if holds else _RED, f"{'verified' if holds else 'NOT TRUE'}: {claim}"))

    async def play(self, *chapters: Callable[[Tour], Awaitable[None]]) -> None:
        """Run chapters one after the other. A failed step ends the tour, and is reported at its end."""
        try:
            for chapter in chapters if not self._is_over else ():
                await chapter(self)
        except StepFailed as error:
            self.failures.append(str(error))
            self._is_over = True

    async def call(self, tool: str, **arguments: Any) -> Any:
        """Call a tool, and save its pictures. Return its structured content, even if a motion failed. Raises
        `StepFailed`.
        """
        result, text = await self._ask(tool, arguments)
        if result.structured_content is None:
            raise StepFailed(f"{tool}: {text}")
        return result.structured_content

    async def refused(self, tool: str, **arguments: Any) -> str:
        """Call a tool that has to be refused. Return the reason. Raises `StepFailed` if it was not refused."""
        result, text = await self._ask(tool, arguments)
        if not result.is_error:
            raise StepFailed(f"{tool} was not refused: {text}")
        self.show(_paint(_RED, text))
        return text

    async def _ask(self, tool: str, arguments: dict[str, Any]) -> tuple[CallToolResult, str]:
        print(_paint(_DIM, f"  > {tool} {json.dumps(arguments)}"), flush=True)
        started = time.monotonic()

        async def on_progress(progress: float, total: float | None, message: str | None) -> None:
            print(_paint(_DIM, f"    … {progress:.0f}/{total or 0:.0f} s  {message or ''}"), flush=True)

        result = await self.client.call_tool(tool, arguments, progress_callback=on_progress, meta={STRUCTURED: True})
        elapsed_s = time.monotonic() - started
        text = "".join(getattr(block, "text", "") for block in result.content)
        self.transcript.append({"tool": tool, "arguments": arguments, "seconds": round(elapsed_s, 3), "text": text})
        for image in result.content:
            if isinstance(image, ImageContent):
                self.show(f"picture saved: {self._save(image)}")
        return result, text

    def _save(self, image: ImageContent) -> Path:
        self._pictures += 1
        path = self._folder / f"picture-{self._pictures}.{image.mime_type.split('/')[1]}"
        path.write_bytes(base64.b64decode(image.data))
        return path

    def finish(self) -> int:
        """Write the transcript, and return the exit code."""
        path = self._folder / "transcript.json"
        path.write_text(json.dumps(self.transcript, indent=1, ensure_ascii=False))
        seconds = time.monotonic() - self._started
        kept = "Pictures and transcript" if self._pictures else "Transcript"
        print(f"\nThe tour took {seconds:.0f} s. {kept}: {self._folder.resolve()}")
        for failure in self.failures:
            print(_paint(_RED, f"failed: {failure}"), file=sys.stderr)
        return 1 if self.failures else 0


def _paint(style: str, text: str) -> str:
    return f"{style}{text}{_END}" if sys.stdout.isatty() else text
