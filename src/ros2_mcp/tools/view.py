"""Tools of the page in the chat: the model opens it and asks what it shows; the page requests its data."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import time as now_s
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ros2_mcp.ops.results.results import HIDDEN, Report
from ros2_mcp.robot import Robot
from ros2_mcp.robot.session import Session
from ros2_mcp.tools.arguments import FromBag, RecordedTime
from ros2_mcp.tools.declare import ForPage, tool
from ros2_mcp.tools.injection import AtOneTime, ShowsPages
from ros2_mcp.view.opening import OpenedView, OpeningRequest, opened
from ros2_mcp.view.picks import Pick
from ros2_mcp.view.viewing import Viewing

PLACE = 140

PageRequest = Annotated[dict[str, Any], Field(description="What the page asks.")]


def _one_or_several(value: Any) -> Any:
    """Convert the name of one topic to a list of one."""
    return [value] if isinstance(value, str) else value


_Names = BeforeValidator(_one_or_several)
Topics = Annotated[
    list[str] | None, _Names, Field(max_length=8, description="Topics for the panels. Default: the first.")
]
PlotFields = Annotated[
    list[str] | None, _Names, Field(max_length=8, description="Numeric fields of the topic, for a plot.")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSeen:
    """One page: a line for each of its `panels`, and what the user picked there, the newest last. `last_request_s_ago`
    is the time since the page last requested data.
    """

    subject: str
    open: bool
    last_request_s_ago: float
    panels: Sequence[str]
    picked: Sequence[Pick]


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewState:
    """The pages of this robot, the newest first."""

    pages: Sequence[PageSeen]
    told: Sequence[str] = field(default=(), metadata=HIDDEN)

    def summary(self) -> list[str]:
        """Return what each page shows, and what was picked on it."""
        return list(self.told)


@tool(
    title="The live scene",
    risk="read",
    group="view",
    by_default=False,
    recorded=True,
    also_named="ros2_viewer_app",
    aliases={"topic_name": "topics", "preferred_kind": "kind", "plot_fields": "fields", "auto_start": ""},
    opens_page=True,
    finds="show the user a live page: camera, map, plot, viewer",
)
async def ros2_view(
    robot: Robot,
    session: Session,
    report: Report,
    shows_pages: ShowsPages,
    viewing: Viewing,
    topics: Topics = None,
    kind: Annotated[
        Literal["auto", "image", "pointcloud", "plot"],
        Field(description="Kind of panel. Default: by the type of the topic."),
    ] = "auto",
    fields: PlotFields = None,
    bag: FromBag = "",
    time: RecordedTime = "",
    *,
    source: AtOneTime,
) -> OpenedView:
    """Show your user the live scene beside the chat: map, camera, what you do, values, log, a stop button. A client
    that shows no pages gets a picture, and how to open the scene in a browser."""
    at_s = source.covers_ns[1] / 1e9 if time and source.covers_ns else None
    request = OpeningRequest(topics=topics or (), kind=kind, fields=fields or (), bag=bag, at_s=at_s)
    others = sum(state.is_open for state in viewing.states(session.principal.name))
    return await opened(robot, source, request, shows_pages=shows_pages, others=others, report=report)


@tool(
    title="What the user sees",
    risk="read",
    group="view",
    by_default=False,
    recorded=True,
    finds="what did the user click, pick or point at",
)
async def ros2_view_state(session: Session, viewing: Viewing) -> ViewState:
    """Show what your user sees on the pages, and what they picked there: a place (metres in a frame), a point in 3D, a
    box in a picture, a time in a plot."""
    states = viewing.states(session.principal.name)
    told: list[str] = []
    pages: list[PageSeen] = []
    for state in states:
        ago_s = round(max(now_s() - state.asked_at, 0.0), 1)
        page = "A page" if state.is_open else f"A page, hidden or closed {ago_s:g} s ago,"
        told.append(f"{page} of {state.subject}:")
        told += [f"- {line}" for line in state.shows]
        told += [pick.summary() for pick in state.picks] or ["Nothing is picked."]
        pages.append(
            PageSeen(
                subject=state.subject,
                open=state.is_open,
                last_request_s_ago=ago_s,
                panels=state.shows,
                picked=state.picks,
            )
        )
    if browser := await asyncio.to_thread(viewing.picked_in_browser):
        ago_s = round(max(now_s() - browser.at_s, 0.0), 1)
        told += [f"In a browser, {ago_s:g} s ago, of {browser.subject}:", *(pick.summary() for pick in browser.picks)]
        subject = f"{browser.subject}, in a browser"
        pages.append(PageSeen(subject=subject, open=False, last_request_s_ago=ago_s, panels=(), picked=browser.picks))
    return ViewState(pages=pages, told=told or ["No page is open, and nothing was picked."])


@tool(title="Update of the page", risk="read", group="view", by_default=False, recorded=True, audience="page")
async def ros2_view_frame(session: Session, viewing: Viewing, asked: PageRequest, bag: FromBag = "") -> ForPage:
    """For the page alone: what is new in its panels."""
    update = await viewing.update(asked, bag, session.principal.name)
    return ForPage(update, f"New: {', '.join(update['panels']) or 'nothing'}.")


@tool(title="Question of the page", risk="read", group="view", by_default=False, recorded=True, audience="page")
async def ros2_view_ask(viewing: Viewing, asked: PageRequest, bag: FromBag = "") -> ForPage:
    """For the page alone: a large part, or what was picked."""
    return ForPage(await viewing.answer(asked, bag), "Answered.")


@tool(title="Stop from the page", risk="stop", group="view", by_default=False, recorded=True, audience="page")
async def ros2_view_stop(viewing: Viewing) -> ForPage:
    """For the page alone: stops every server that acts on this robot from this machine, and latches."""
    stopped = await viewing.stop()
    return ForPage(stopped, str(stopped["summary"]))
