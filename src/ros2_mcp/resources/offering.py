"""The resources as the SDK serves them, with the methods to subscribe to them."""

from __future__ import annotations

from inspect import Parameter, Signature
from typing import Any

from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.exceptions import ResourceError, ResourceNotFoundError
from mcp.server.mcpserver.resources import ResourceSecurity
from mcp.server.subscriptions import SubscriptionBus
from mcp.types import SubscribeRequestParams, SubscriptionsListenRequestParams, UnsubscribeRequestParams

from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.ops.watching import Watcher
from ros2_mcp.resources.catalogue import RESOURCES, Declared
from ros2_mcp.resources.content import fitting
from ros2_mcp.resources.push import Push
from ros2_mcp.robot import Robot


def offer(server: MCPServer[Any], robot: Robot, bus: SubscriptionBus) -> Watcher:
    """Registers every resource and the subscription methods of both eras; events of `bus` reach listeners too."""
    watcher = Watcher(robot)
    for declared in RESOURCES:
        names_are_no_paths = ResourceSecurity(exempt_params=set(declared.template.variable_names))
        register = server.resource(
            declared.uri,
            name=declared.name,
            title=declared.title,
            description=declared.description,
            mime_type="application/json",
            security=names_are_no_paths,
        )
        register(_reader(declared, robot, watcher))
    push, lowlevel = Push(watcher, bus), server._lowlevel_server  # pyright: ignore[reportPrivateUsage]
    lowlevel.add_request_handler("resources/subscribe", SubscribeRequestParams, push.subscribe)
    lowlevel.add_request_handler("resources/unsubscribe", UnsubscribeRequestParams, push.unsubscribe)
    lowlevel.add_request_handler("subscriptions/listen", SubscriptionsListenRequestParams, push.listen)
    return watcher


def _reader(declared: Declared, robot: Robot, watcher: Watcher) -> Any:
    """The function that the SDK calls, with the template's variables as its parameters."""

    async def read(**variables: str) -> str:
        try:
            return fitting(await declared.read(robot, watcher, **variables), robot.result_bytes)
        except (NotFound, BadInput) as error:
            raise ResourceNotFoundError(str(error)) from error
        except RobotError as error:
            raise ResourceError(f"{type(error).__name__}: {error}") from error

    template = declared.template
    read.__annotations__ = dict.fromkeys(template.variable_names, str)
    read.__signature__ = Signature(  # pyright: ignore[reportFunctionMemberAccess]
        [_parameter(name, may_lack=name in template.query_variable_names) for name in template.variable_names]
    )
    return read


def _parameter(name: str, *, may_lack: bool) -> Parameter:
    default = "" if may_lack else Parameter.empty
    return Parameter(name, Parameter.KEYWORD_ONLY, annotation=str, default=default)
