"""Prompts over MCP: `prompts/list`, `prompts/get`, and notifications when the user's folder changes."""

from __future__ import annotations

from typing import Any

from mcp.server.context import CallNext, ServerRequestContext
from mcp.server.subscriptions import SubscriptionBus
from mcp.shared.exceptions import MCPError
from mcp.shared.subscriptions import PromptsListChanged
from mcp.types import (
    INVALID_PARAMS,
    GetPromptRequestParams,
    GetPromptResult,
    ListPromptsResult,
    PaginatedRequestParams,
    PromptArgument,
    PromptMessage,
    TextContent,
)
from mcp.types import Prompt as ListedPrompt

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import LAYOUT, visible
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.prompts.prompt import Prompt


class Prompts:
    """Answers `prompts/list` and `prompts/get` from the catalog. `tell_news` is a middleware that notifies clients of
    changes.
    """

    def __init__(self, catalog: Catalog, events: SubscriptionBus) -> None:
        self._catalog = catalog
        self._events = events

    async def list(self, _: Any, __: PaginatedRequestParams | None) -> ListPromptsResult:
        """List the current prompts."""
        return ListPromptsResult(prompts=[_listed(prompt) for prompt in (await self._catalog.prompts()).values()])

    async def get(self, _: Any, params: GetPromptRequestParams) -> GetPromptResult:
        """Return the messages of one prompt.

        Raises:
            MCPError: for an unknown name or wrong arguments.
        """
        try:
            messages = await self._catalog.messages(params.name, params.arguments or {})
            description = (await self._catalog.prompt(params.name)).description
        except RobotError as error:
            raise MCPError(INVALID_PARAMS, visible(str(error))) from error
        return GetPromptResult(
            description=visible(description, keep=LAYOUT),
            messages=[
                PromptMessage(role=m.role, content=TextContent(type="text", text=visible(m.text, keep=LAYOUT)))
                for m in messages
            ],
        )

    async def tell_news(self, ctx: ServerRequestContext[Any], call_next: CallNext) -> Any:
        """Notify clients of changed prompts, with the next request of any client: files are not watched."""
        if ctx.request_id is not None and ctx.method != "prompts/list" and self._catalog.has_news():
            await self._events.publish(PromptsListChanged())
            await ctx.session.send_prompt_list_changed()
        return await call_next(ctx)


def _listed(prompt: Prompt) -> ListedPrompt:
    return ListedPrompt(
        name=prompt.name,
        title=visible(prompt.title),
        description=visible(prompt.description, keep=LAYOUT),
        arguments=[
            PromptArgument(
                name=argument.name,
                description=visible(argument.explained(), keep=LAYOUT),
                required=argument.required and argument.default is None,
            )
            for argument in prompt.arguments
        ],
    )
