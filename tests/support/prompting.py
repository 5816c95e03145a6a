"""A client that fetches prompts, completes their arguments and takes the steps they name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from mcp.shared.exceptions import MCPError
from mcp.types import PromptReference, ResourceTemplateReference

from support.agent import Agent, agent_for
from support.prompt_steps import steps_of


class PromptAgent:
    """An `Agent` that also knows prompts."""

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self._client, self._run = agent.client, agent._portal.call

    def prompts(self) -> dict[str, Any]:
        """Every prompt by name."""
        return {prompt.name: prompt for prompt in self._run(self._client.list_prompts).prompts}

    def text(self, prompt: str, **given: str) -> str:
        """The text of a prompt."""
        messages = self._run(self._client.get_prompt, prompt, given).messages
        return "\n".join(message.content.text for message in messages)

    def refusal(self, prompt: str, **given: str) -> str:
        """What is said of a prompt that cannot be had."""
        try:
            return f"not refused: {self.text(prompt, **given)}"
        except MCPError as error:
            return str(error)

    def take(self, prompt: str, **given: str) -> list[dict[str, Any]]:
        """The results of the steps that a prompt names, taken as written."""
        steps = steps_of(self.text(prompt, **given))
        assert steps
        return [self.agent.call(tool, **arguments) for tool, arguments in steps]

    def complete(self, prompt: str, argument: str, typed: str = "", **given: str) -> list[str]:
        """What a prompt's argument may become; nothing where the robot does not answer within a second."""
        return self._complete(PromptReference(name=prompt), argument, typed, given)

    def complete_uri(self, template: str, variable: str, typed: str = "") -> list[str]:
        """What a variable of a resource template may become; nothing where the robot does not answer in a second."""
        return self._complete(ResourceTemplateReference(uri=template), variable, typed, {})

    def _complete(self, ref: Any, argument: str, typed: str, given: dict[str, str]) -> list[str]:
        asked = {"name": argument, "value": typed}
        return self._run(partial(self._client.complete, ref, asked, context_arguments=given)).completion.values


@contextmanager
def prompt_agent(environment: dict[str, str], *options: str, mode: Any = "auto") -> Iterator[PromptAgent]:
    """A client of a newly started server; both end with the block."""
    with agent_for(environment, *options, mode=mode) as agent:
        yield PromptAgent(agent)
