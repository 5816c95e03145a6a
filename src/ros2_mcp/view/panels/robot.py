"""The head of the page: which robot it is, and its topics."""

from __future__ import annotations

from typing import Any

from ros2_mcp.model.errors import RobotError
from ros2_mcp.view.look import Content, Look, Panel

_MOST_TOPICS = 1000


class RobotPanel(Panel):
    """Shows which robot it is, whether it is reachable, and its topics."""

    name = "robot"
    period_s = 1.0

    async def show(self, look: Look) -> Content | None:
        """Return the robot's state. Never raises, because this panel shows why the others are empty."""
        content: dict[str, Any] = {"title": self._page.title, "live": look.source.is_live, "topics": []}
        if self._page.source.covers_ns:
            begin_ns, end_ns = self._page.source.covers_ns
            content |= {"source": self._page.source.title, "begin_s": begin_ns / 1e9, "end_s": end_ns / 1e9}
        graph = look.robot.graph
        try:
            rows = sorted(await graph.topics())[:_MOST_TOPICS]
        except RobotError as error:
            return {**content, "why": str(error)}
        own = ("/parameter_events",)
        content["topics"] = [[row.name, *row.types[:1]] for row in rows if row.publishers and row.name not in own]
        if look.source.is_live:
            content["why"] = await graph.absence() or graph.failure
        return content
