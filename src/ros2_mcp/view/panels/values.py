"""The values of one topic."""

from __future__ import annotations

from collections.abc import Sequence

from ros2_mcp.model.errors import NotFound
from ros2_mcp.model.text import named
from ros2_mcp.ops.pictures.next_message import next_message
from ros2_mcp.ops.results.results import silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.view.look import Content, Look, PageContext, Panel, Shown, when

_FIRST = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState")
"""Types of the topic that is shown by default: motion first."""
_MOST_ARRAY, _MOST_STRING, _MOST_BYTES = 12, 400, 12_000
"""Limits of one message: as much as a person looks at while it changes."""
_MOST_JOINTS = 64
"""The limit for a message with a row for each joint: a humanoid with both hands."""


class ValuesPanel(Panel):
    """Shows the newest message of a topic, with its rate."""

    name = "values"
    period_s = 0.2

    def __init__(self, page: PageContext) -> None:
        super().__init__(page)
        self._shown = Shown()

    async def show(self, look: Look) -> Content | None:
        """Return the newest message of the chosen topic, or of a topic that shows how the robot moves."""
        from ros2_mcp.values.render import RenderOptions  # imports numpy, only when needed

        topic = look.chosen or await first_topic(look.source)
        if not topic:
            raise NotFound("There is no topic to show.")
        rate_hz: float | None = None
        is_old = False
        publishers: Sequence[str] = ()
        if look.source.is_live:
            found = await self._shown.newer(look.robot, topic)
            if found is None:
                why = f"No message has come on {named(topic)} yet."
                return None if self._shown.sample else {"topic": topic, "why": why}
            sample, newest, listening = found
            kind, rate_hz, is_old = listening.type, newest.rate_hz(), listening.is_from_before(sample)
            publishers = sorted({one.who for one in listening.publishers})
        else:
            kind = await look.source.type_of(topic)
            sample = (await next_message(look.source, topic, kind, silent)).sample
            await look.robot.values.learn(kind)
        most = _MOST_JOINTS if kind == "sensor_msgs/msg/JointState" else _MOST_ARRAY
        options = RenderOptions(max_array=most, max_string=_MOST_STRING, max_bytes=_MOST_BYTES)
        rendered = await look.robot.values.render(kind, sample.data, options)
        return {
            "topic": topic,
            "type": kind,
            **when(sample, is_old),
            "rate_hz": rate_hz,
            "publishers": list(publishers),
            "bytes": sample.size,
            "value": rendered.value,
        }


async def first_topic(source: Source) -> str:
    """Return the topic that is shown by default; empty if there is none."""
    for kind in _FIRST:
        if found := await source.publishing(kind):
            return found[0]
    return ""
