"""Show the scene to the user: on a page in the chat, or, if the client shows no pages, as a picture with text."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import named
from ros2_mcp.ops.results.results import HIDDEN, Report, WithPictures, silent
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.ops.space.scene import scene
from ros2_mcp.ops.space.scene_picture import SceneRequest
from ros2_mcp.robot import Robot
from ros2_mcp.view.panels import panel_types

_OTHERS = (
    "This is a new page: {others} open already and unchanged. On an open page, the user selects what it shows in the "
    "heads of its panels."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpeningRequest:
    """The selection to show: topics, a `kind` if their types do not determine it, and `fields` of the first for a plot.

    `bag` is the name of the recording, and `at_s` a time in it (Unix time, s).
    """

    topics: Sequence[str] = ()
    kind: str = "auto"
    fields: Sequence[str] = ()
    bag: str = ""
    at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedView(WithPictures):
    """What the user is shown: `shown_as` is "page" or "picture". `panels` maps each panel to its topic."""

    shown_as: str
    subject: str
    bag: str
    at_s: float | None
    panels: Mapping[str, str]
    lines: Sequence[str] = field(default=(), metadata=HIDDEN)
    note: str = ""

    def summary(self) -> list[str]:
        """Say where the scene is shown, and what it shows."""
        return [*self.lines, *([self.note] if self.note else [])]


async def opened(
    robot: Robot,
    source: Source,
    request: OpeningRequest,
    *,
    shows_pages: bool,
    others: int = 0,
    report: Report = silent,
) -> OpenedView:
    """Open the page; for a client that shows no pages, return a picture of the scene instead.

    A client shows a page of its own for each call: `others` are open already.

    Raises:
        NotFound: for a topic that does not exist.
    """
    panels: dict[str, str] = {}
    by_kind = {kind.shows_kind: kind.name for kind in panel_types()}
    by_type = {type_name: kind.name for kind in panel_types() for type_name in kind.shows_types}
    for topic in request.topics:
        panel = by_kind.get(request.kind) or by_type.get(await source.type_of(topic), "values")
        panels.setdefault(panel, topic)
    if request.fields and request.topics:
        panels["plot"] = ",".join(f"{request.topics[0]}:{one}" for one in request.fields)
    subject = "the robot, live" if source.is_live else f"the recording {source.title}"
    chosen = "".join(f", in the panel {panel} {named(topic)}" for panel, topic in panels.items())
    told = OpenedView(
        shown_as="page" if shows_pages else "picture",
        subject=subject,
        bag=request.bag,
        at_s=request.at_s,
        panels=panels,
    )
    if shows_pages:
        line = f"Your user sees the page beside the chat: {subject}{chosen}, with a stop button."
        note = _OTHERS.format(others="1 page is" if others == 1 else f"{others} pages are") if others else ""
        return replace(told, lines=[line, "ros2_view_state reports what they look at and have picked."], note=note)
    bag = f" --bag {shlex.quote(request.bag)}" if request.bag else ""
    how = f"This client shows no pages. Your user sees {subject} in a browser with: ros2-mcp view{bag}"
    where = "in a terminal of the server's machine, with the options of this server that say which robot."
    try:
        picture = await scene(robot, source, SceneRequest(), report)
    except RobotError as error:
        return replace(told, lines=[f"{how} ({where})"], note=f"No picture of the scene: {error}")
    lines = [f"{how} ({where})", *picture.summary()]
    return replace(told, lines=lines, pictures=picture.pictures, images=picture.images)
