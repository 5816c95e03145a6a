"""All prompts of one server: the base prompts, the prompts in the user's folder, kept programs, and the prompts of the
user's code.

A prompt that names a tool that is not offered says so. A base prompt then says only that, without the name of the tool,
because models call the tools that they read of.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.prompts import kept
from ros2_mcp.prompts.base import base_prompts
from ros2_mcp.prompts.folder import PromptFolder
from ros2_mcp.prompts.mistakes import Mistake, Tell, tell_on_stderr
from ros2_mcp.prompts.prompt import Message, Prompt
from ros2_mcp.robot import Robot

_TOOL = re.compile(r"\bros2_\w+")
Load = Callable[[Tell], Sequence[Prompt]]
WhyMissing = Callable[[Collection[str]], str]


class Catalog:
    """The current prompts, by name.

    Args:
        robot: for prompts that name its topics.
        folder: the folder of the user's Markdown files.
        programs: the folder of kept programs, which are prompts if this server runs programs.
        load_code: loads the prompts of the user's code; called once, when prompts are first requested.
        missing: the tools that this server does not offer, each with the reason.
        why_missing: returns, in words, why some tools are not offered.
        tools: the names of all tools.
        tell: called with each mistake in the user's prompts.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        folder: Path | None = None,
        programs: Path | None = None,
        load_code: Load | None = None,
        missing: Mapping[str, str] | None = None,
        why_missing: WhyMissing = lambda _: "its tools are not offered",
        tools: Sequence[str] = (),
        tell: Tell = tell_on_stderr,
    ) -> None:
        self._base = base_prompts(robot, missing or {})
        taken = frozenset(prompt.name for prompt in self._base)
        self._folder = PromptFolder(folder, tell, taken=taken, tools=frozenset(tools)) if folder else None
        self._programs = _kept_in(programs, tell) if programs and kept.RUNS not in (missing or {}) else None
        self._load_code = load_code
        self._of_code: Sequence[Prompt] | None = None if load_code else ()
        self._loading = asyncio.Lock()
        self._missing = missing or {}
        self._why_missing = why_missing
        self._tell = tell

    async def prompts(self) -> Mapping[str, Prompt]:
        """Return all prompts by name, in the order of `prompts/list`."""
        prompts = {prompt.name: prompt for prompt in self._base}
        for prompt in self._folder.prompts() if self._folder else ():
            prompts[prompt.name] = prompt
        for prompt in self._programs.prompts() if self._programs else ():
            prompts.setdefault(prompt.name, prompt)
        for prompt in await self._code():
            prompts.setdefault(prompt.name, prompt)
        return prompts

    async def prompt(self, name: str) -> Prompt:
        """Return the prompt of that name.

        Raises:
            NotFound: with the most similar name.
        """
        prompts = await self.prompts()
        if name not in prompts:
            hint = did_you_mean(name, list(prompts), f"There are: {', '.join(prompts)}.")
            raise NotFound(f"There is no prompt {name!r}.", hint)
        return prompts[name]

    async def messages(self, name: str, given: Mapping[str, str]) -> Sequence[Message]:
        """Return the messages of a prompt. If they name a tool that is not offered, a note says so, and why.

        Raises:
            NotFound: if there is no such prompt.
            BadInput: naming the argument, its value and what is allowed.
        """
        return await self.messages_of(await self.prompt(name), given)

    def base(self, name: str) -> Prompt | None:
        """Return the base prompt of that name; None for other names."""
        return next((prompt for prompt in self._base if prompt.name == name), None)

    async def messages_of(self, prompt: Prompt, given: Mapping[str, str]) -> Sequence[Message]:
        """Return the messages of a prompt of this catalog; see `messages`."""
        messages = await prompt.messages(given)
        named = {tool for message in messages for tool in _TOOL.findall(message.text)} & self._missing.keys()
        if not named:
            return messages
        if prompt in self._base:
            return [
                Message(f"{prompt.title}: not possible here, because {self._why_missing(named)}. Tell the user so.")
            ]
        absent = ", ".join(f"{tool} ({self._missing[tool]})" for tool in sorted(named))
        note = f"Not offered by this server: {absent}. Tell the user if this cannot be done without them."
        return [*messages, Message(note)]

    def has_news(self) -> bool:
        """Return whether a folder has changed since the prompts were read. Each change is reported once."""
        news = [folder.has_news() for folder in (self._folder, self._programs) if folder]
        return any(news)

    async def _code(self) -> Sequence[Prompt]:
        """Return the prompts of the user's code. Those with a name that is taken are reported and dropped."""
        async with self._loading:
            if self._of_code is None and self._load_code:
                found: dict[str, Prompt] = {}
                for prompt in await asyncio.to_thread(self._load_code, self._tell):
                    if prompt.name in found or prompt.name in {base.name for base in self._base}:
                        self._tell(Mistake("prompts of code", 0, f"The name {prompt.name} is already taken."))
                    else:
                        found[prompt.name] = prompt
                self._of_code = list(found.values())
        return self._of_code or ()


def _kept_in(folder: Path, tell: Tell) -> PromptFolder:
    return PromptFolder(folder.expanduser(), tell, parse=kept.parse, may_lack=True)
