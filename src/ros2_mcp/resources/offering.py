"""The resources as clients see them: lists, contents, and subscriptions."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from mcp.server.subscriptions import SubscriptionBus
from mcp.shared.exceptions import MCPError
from mcp.types import (
    INTERNAL_ERROR,
    INVALID_PARAMS,
    ListResourcesResult,
    ListResourceTemplatesResult,
    PaginatedRequestParams,
    ReadResourceRequestParams,
    ReadResourceResult,
    Resource,
    ResourceTemplate,
    TextResourceContents,
)

from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.text import visible
from ros2_mcp.ops.results.results import answer_bytes
from ros2_mcp.resources.by_robot import ROBOT, ByRobot
from ros2_mcp.resources.catalogue import RESOURCES, matching
from ros2_mcp.resources.fitting import fitting
from ros2_mcp.resources.push import Push
from ros2_mcp.robot import Robot

_MIME_TYPE = "application/json"
_logger = logging.getLogger(__name__)


class Resources:
    """Answers requests about resources; `push` answers their subscriptions."""

    def __init__(self, robots: Mapping[str, Robot], bus: SubscriptionBus) -> None:
        self._by_robot = ByRobot(robots)
        self.push = Push(self._by_robot.watched, bus)

    async def list(self, _: Any, __: PaginatedRequestParams | None) -> ListResourcesResult:
        """List the resources without variables."""
        return ListResourcesResult(
            resources=[
                Resource(uri=uri, name=name, title=title, description=row.description, mime_type=_MIME_TYPE)
                for row in RESOURCES
                if not row.template.variable_names
                for uri, name, title in self._by_robot.listed(row)
            ]
        )

    async def list_templates(self, _: Any, __: PaginatedRequestParams | None) -> ListResourceTemplatesResult:
        """List the templates: resources with variables."""
        return ListResourceTemplatesResult(
            resource_templates=[
                ResourceTemplate(
                    uri_template=self._by_robot.template(row.uri),
                    name=row.name,
                    title=row.title,
                    description=row.description,
                    mime_type=_MIME_TYPE,
                )
                for row in RESOURCES
                if row.template.variable_names
            ]
        )

    async def read(self, _: Any, params: ReadResourceRequestParams) -> ReadResourceResult:
        """Return the content of one resource as JSON.

        Raises:
            MCPError: for an unknown URI or robot, a bad variable, or a failed read. Its data contains the URI.
        """
        uri = str(params.uri)
        try:
            robot, watcher, plain, lead = self._by_robot.found(uri)
            resource, variables = matching(plain)
            chosen = {**dict.fromkeys(resource.template.query_variable_names, ""), **variables}
            text = fitting({**lead, **await resource.read(robot, watcher, **chosen)}, answer_bytes(robot))
        except (NotFound, BadInput) as error:
            raise MCPError(INVALID_PARAMS, visible(str(error)), {"uri": visible(uri)}) from error
        except RobotError as error:
            raise MCPError(
                INTERNAL_ERROR, visible(f"{type(error).__name__}: {error}"), {"uri": visible(uri)}
            ) from error
        except Exception as error:  # a fault of ours: the traceback is logged, not sent to the client
            _logger.exception("reading %s failed", uri)
            raise MCPError(INTERNAL_ERROR, visible(f"Error reading resource {uri}"), {"uri": visible(uri)}) from error
        return ReadResourceResult(contents=[TextResourceContents(uri=uri, text=text, mime_type=_MIME_TYPE)])

    def completed_by(self, template: str, variable: str) -> tuple[Sequence[str], str]:
        """Return the values that complete a variable of a template: fixed choices, or a kind of live names,
        or neither.
        """
        if variable == ROBOT:
            return self._by_robot.names, ""
        kinds = [
            row.completes[variable]
            for row in RESOURCES
            if self._by_robot.template(row.uri) == template and variable in row.completes
        ]
        return (), kinds[0] if kinds else ""
