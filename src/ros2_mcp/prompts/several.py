"""The prompts of a server with several robots: each prompt has a further argument that names the robot."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ros2_mcp.model.arguments import Argument
from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.text import listed
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.prompts.prompt import Message, Prompt

ROBOT = "robot"
_STEP = re.compile(r"(Call ros2_\w+ with \{)(?=(\}?))")
"""A step of a prompt (`prompts/prompt.py`): a tool, and its arguments as JSON."""
_MOST_NAMED = 15
"""The most robots in one error text."""


class CatalogOfSeveral(Catalog):
    """A catalog whose prompts name a robot, and instruct the model to pass that name to each tool.

    `whole` has all prompts. `own` has, for each robot, its base prompts and the tools that are not offered for it.
    """

    def __init__(self, whole: Catalog, own: Mapping[str, Catalog]) -> None:
        self._whole = whole
        self._own = own
        self._argument = Argument(ROBOT, "Which robot", required=True, choices=list(own))

    async def prompts(self) -> Mapping[str, Prompt]:
        """Return all prompts by name, in the order of `prompts/list`.

        If a prompt has an argument `robot` already, it is declared as this one, and also receives the value.
        """
        found = await self._whole.prompts()
        return {name: replace(one, arguments=self._with_robot(one)) for name, one in found.items()}

    async def messages(self, name: str, given: Mapping[str, str]) -> Sequence[Message]:
        """Return the messages of a prompt for one robot. Raises as `Catalog.messages`."""
        prompt = await self._whole.prompt(name)
        if ROBOT not in given:
            raise BadInput(f"The prompt {name} needs the argument {ROBOT}: {listed(list(self._own), _MOST_NAMED)}.")
        robot = str(self._argument.value(given[ROBOT]))
        own = self._own[robot]
        rest = given if prompt.argument(ROBOT) else {key: value for key, value in given.items() if key != ROBOT}
        first, *others = await own.messages_of(own.base(name) or prompt, rest)
        lead = f'This is about the robot {robot}: pass "{ROBOT}": "{robot}" to each tool.\n'
        return [replace(one, text=_about(robot, one.text)) for one in (replace(first, text=lead + first.text), *others)]

    def has_news(self) -> bool:
        """Return whether the user's folder has changed since the prompts were read."""
        return self._whole.has_news()

    def _with_robot(self, prompt: Prompt) -> Sequence[Argument]:
        others = [argument for argument in prompt.arguments if argument.name != ROBOT]
        return (self._argument, *others)


def _about(robot: str, text: str) -> str:
    """Return the text with the robot added to the arguments of each step."""
    return _STEP.sub(lambda step: f'{step[1]}"{ROBOT}": "{robot}"{"" if step[2] else ", "}', text)
