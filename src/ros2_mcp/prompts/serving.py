"""Prompts over MCP: `prompts/list` and `prompts/get`, and word to the client when the user's folder changes."""

from __future__ import annotations

from typing import Any

from mcp.server.context import CallNext, ServerRequestContext
from mcp.server.mcpserver import MCPServer
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
from ros2_mcp.prompts.catalog import Catalog
from ros2_mcp.prompts.prompt import Prompt


def offer_prompts(server: MCPServer[None], catalog: Catalog, events: SubscriptionBus) -> None:
    """Lets the server answer with the prompts of the catalog, and tell listeners of either era when they change."""

    async def list_prompts(_: Any, __: PaginatedRequestParams) -> ListPromptsResult:
        return ListPromptsResult(prompts=[_listed(prompt) for prompt in (await catalog.prompts()).values()])

    async def get_prompt(_: Any, params: GetPromptRequestParams) -> GetPromptResult:
        try:
            messages = await catalog.messages(params.name, params.arguments or {})
            description = (await catalog.prompt(params.name)).description
        except RobotError as error:
            raise MCPError(INVALID_PARAMS, str(error)) from error
        return GetPromptResult(
            description=description,
            messages=[PromptMessage(role=m.role, content=TextContent(type="text", text=m.text)) for m in messages],
        )

    async def tell_news(ctx: ServerRequestContext[Any], call_next: CallNext) -> Any:
        """A change is noticed with the next request of a client, whatever that asks for."""
        if ctx.request_id is not None and ctx.method != "prompts/list" and catalog.has_news():
            await events.publish(PromptsListChanged())
            await ctx.session.send_prompt_list_changed()
        return await call_next(ctx)

    server.middleware.append(tell_news)
    lowlevel = server._lowlevel_server  # pyright: ignore[reportPrivateUsage]
    lowlevel.add_request_handler("prompts/list", PaginatedRequestParams, list_prompts)
    lowlevel.add_request_handler("prompts/get", GetPromptRequestParams, get_prompt)


def _listed(prompt: Prompt) -> ListedPrompt:
    return ListedPrompt(
        name=prompt.name,
        title=prompt.title,
        description=prompt.description,
        arguments=[
            PromptArgument(
                name=argument.name,
                description=argument.explained(),
                required=argument.required and argument.default is None,
            )
            for argument in prompt.arguments
        ],
    )
