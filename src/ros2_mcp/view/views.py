"""Views: the state of each open page, updated while the page asks, and closed when it no longer does."""

from __future__ import annotations

import asyncio
import base64
import logging
import secrets
from collections import deque
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import monotonic, time
from typing import Any, Protocol

import anyio

from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.text import visible, visible_json
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.sources.from_before import FromBefore
from ros2_mcp.ops.sources.newest import NewestOfRobot
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.look import MOST_NAMED, Chunks, Content, Look, PageContext, Panel
from ros2_mcp.view.panels import panel_types
from ros2_mcp.view.panels.image import ImagePanel
from ros2_mcp.view.picks import Pick, keep, picks_of

MOST_VIEWS = 4
"""Open pages: a user has it open on a screen and a phone, and forgets to close a page."""
MOST_WAIT_MS = 1500
"""Longest wait of one update: chat hosts pass calls on through one or two processes with time-outs of their own."""
IDLE_S = 10.0
"""Seconds without a request, after which a view is closed: a hidden or closed page costs nothing."""
_UNWANTED_S = 4.0
"""Seconds without a request, after which a panel is not updated: it is hidden, or off the screen."""
_FAILED_S = 1.0
"""Seconds between two attempts of a panel that cannot be shown."""
_MOST_TOPIC = 300
_PART_BYTES = 300_000
"""Bytes of a large part in one answer: base64 adds a third, and chat hosts are known to pass on this size."""
_MOST_PAST = 4
"""Closed pages whose last state is still reported."""
_ROUNDED_NS = 1000
"""A page's time is a float, off by some 100 ns: this margin includes the message at exactly that time."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UpdateRequest:
    """A page's request.

    `view` is its id (empty: a new view), `panels` the selection of each panel, `seen` the number of each panel's
    content that the page has, `wait_ms` how long to wait for news, and `at_s` the time that is shown of a recording
    (Unix time, s).
    """

    view: str = ""
    panels: Mapping[str, str] = field(default_factory=dict[str, str])
    seen: Mapping[str, int] = field(default_factory=dict[str, int])
    wait_ms: int = 0
    at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PageState:
    """The content of one page now, or when it was closed: a line for each visible panel, and the picks.

    `asked_at` is the time of its last request (Unix time, s), `who` the client that opened it.
    """

    id: str
    who: str
    subject: str
    is_open: bool
    asked_at: float
    shows: Sequence[str]
    picks: Sequence[Pick]


class Tasks(Protocol):
    """Starts background work, such as a task group."""

    def start_soon(self, work: Callable[..., Coroutine[Any, Any, None]], /, *arguments: object) -> object:
        """Start a task."""
        ...


@dataclass(eq=False)
class _Shown:
    """One panel with its content; `number` grows with each change."""

    panel: Panel
    chosen: str = ""
    number: int = 0
    content: Content | None = None
    asked_at: float = 0.0
    asked: asyncio.Event = field(default_factory=asyncio.Event)
    scope: anyio.CancelScope | None = None

    def wake(self, *, anew: bool) -> None:
        """Note that the panel is requested.

        With `anew` its selection has changed, and an update in progress is cancelled.
        """
        self.asked_at = monotonic()
        if anew:
            self.content = None
        if anew and self.scope:
            self.scope.cancel()
        self.asked.set()


class View:
    """The state of one open page: its panels, their selections, and the picks."""

    def __init__(self, robot: Robot, source: Source, panels: Sequence[Panel], chunks: Chunks) -> None:
        self.id = secrets.token_hex(16)
        self.who = ""
        self.picks: Sequence[Pick] = ()
        self._told_at = time()
        self.chunks = chunks
        self.asked_at = monotonic()
        self._robot, self._source = robot, source
        self._live = NewestOfRobot(robot) if source.is_live else None
        self._until_ns: int | None = None
        self._shown = {panel.name: _Shown(panel) for panel in panels}
        self._images = next(panel for panel in panels if isinstance(panel, ImagePanel))
        self._news = asyncio.Event()
        self._is_closed = False

    def close(self) -> None:
        """Close the view; a request that waits for news is answered at once."""
        self._is_closed = True
        self._news.set()

    async def run(self) -> None:
        """Update the panels until no request has come for `IDLE_S`, or the view is closed."""
        async with anyio.create_task_group() as tasks:
            for shown in self._shown.values():
                tasks.start_soon(self._keep, shown)
                if self._live:
                    tasks.start_soon(self._beside, shown.panel)
            while monotonic() - self.asked_at < IDLE_S and not self._is_closed:
                await anyio.sleep(0.5)
            tasks.cancel_scope.cancel()

    async def update(self, request: UpdateRequest) -> Mapping[str, Any]:
        """Return the panels with news for the page; wait for the first news."""
        self.asked_at, self._told_at = monotonic(), time()
        until_ns = None if request.at_s is None or self._live else round(request.at_s * 1e9) + _ROUNDED_NS
        has_moved, self._until_ns = until_ns != self._until_ns, until_ns
        for name, chosen in request.panels.items():
            if shown := self._shown.get(name):
                is_other, shown.chosen = chosen != shown.chosen, chosen
                if has_moved or is_other or monotonic() - shown.asked_at > _UNWANTED_S / 2 or self._live:
                    shown.wake(anew=is_other)
        began = monotonic()
        deadline = began + min(request.wait_ms, MOST_WAIT_MS) / 1000
        while not (newer := self._newer(request)) and monotonic() < deadline and not self._is_closed:
            news = self._news
            with anyio.move_on_after(max(deadline - monotonic(), 0.0)):
                await news.wait()
        self.asked_at = monotonic()
        took_ms = round((self.asked_at - began) * 1000)
        return {"view": self.id, "now_s": self._look("").now_ns / 1e9, "took_ms": took_ms, "panels": newer}

    def state(self, subject: str, *, is_open: bool = True) -> PageState:
        """Return what the page shows."""
        until_ns = self._until_ns
        at = f", at {iso_time(until_ns)}" if until_ns is not None else ""
        seen = [shown for shown in self._shown.values() if shown.asked_at > self.asked_at - _UNWANTED_S]
        now_ns = self._look("").now_ns
        return PageState(
            id=self.id,
            who=self.who,
            subject=f"{subject}{at}",
            is_open=is_open,
            asked_at=self._told_at,
            shows=[panel_in_words(one.panel, one.content, now_ns) for one in seen if one.panel.name != "robot"],
            picks=self.picks,
        )

    async def pick(self, picks: Sequence[Pick]) -> None:
        """Store what is picked, in place of earlier picks; for a new box also the depth there."""
        found: list[Pick] = []
        for pick in picks:
            old = next((one for one in self.picks if one.is_same_box(pick)), None)
            if pick.kind == "box" and not old:
                old = pick.with_depth(*await self._images.depth_within(pick.topic, pick.time, pick.box_px))
            found.append(old or pick)
        self.picks = found

    def _newer(self, request: UpdateRequest) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name in request.panels:
            shown = self._shown.get(name)
            if shown and shown.content is not None and shown.number != request.seen.get(name):
                found[name] = {"number": shown.number, **shown.content}
        return found

    def _look(self, chosen: str) -> Look:
        if self._live:
            return Look(self._robot, self._live, chosen)
        begin_ns, end_ns = self._source.covers_ns or (0, 0)
        until_ns = end_ns if self._until_ns is None else min(max(self._until_ns, begin_ns + 1), end_ns)
        return Look(self._robot, self._source.part(begin_ns, until_ns), chosen)

    async def _beside(self, panel: Panel) -> None:
        try:
            await panel.beside(self._robot)
        except Exception:  # an error of one panel must not stop the others, nor the button
            _logger.exception("what the panel %s does beside failed", panel.name)

    async def _keep(self, shown: _Shown) -> None:
        """Update one panel repeatedly while it is requested."""
        while True:
            await shown.asked.wait()
            shown.asked.clear()
            began = monotonic()
            with anyio.CancelScope() as shown.scope:
                content = await self._content(shown)
                if content is not None and content != shown.content:
                    shown.content = content
                    shown.number += 1
                    news, self._news = self._news, asyncio.Event()
                    news.set()
            shown.scope = None
            period_s = shown.panel.period_s
            if content := shown.content:
                period_s = max(period_s, _FAILED_S if content.get("failed") else 0.0)
            if self._live:
                await anyio.sleep(max(began + period_s - monotonic(), 0.0))
                if monotonic() - shown.asked_at < _UNWANTED_S:
                    shown.asked.set()

    async def _content(self, shown: _Shown) -> Content | None:
        try:
            found = await shown.panel.show(self._look(shown.chosen))
        except RobotError as error:
            found = {"why": str(error), "failed": True}
        except Exception:  # an error of one panel must not stop the others, nor the button
            _logger.exception("the panel %s failed", shown.panel.name)
            found = {"why": "This panel failed; the log of ros2-mcp view says how.", "failed": True}
        if found is None:
            return None
        told, _ = visible_json({name: value for name, value in found.items() if name != "bulk"})
        return {**told, "bulk": found["bulk"]} if "bulk" in found else told


class Views:
    """All open pages of one robot or recording. `acting` knows which servers act on the robot.

    Picks made `in_browser` are stored in the state folder, where the agent's server finds them. Packages with meshes
    are searched below `prefixes`, besides the ones that this process finds anyway.
    """

    def __init__(
        self,
        robot: Robot,
        source: Source,
        title: str,
        acting: Acting,
        tasks: Tasks,
        *,
        in_browser: bool = False,
        prefixes: Sequence[Path] = (),
    ) -> None:
        self._in_browser = in_browser
        self._prefixes = prefixes
        self._robot, self._source, self._title = robot, source, title
        self.acting = acting
        self._tasks = tasks
        self._views: dict[str, View] = {}
        self._past: deque[PageState] = deque(maxlen=_MOST_PAST)

    @property
    def is_open(self) -> bool:
        """Whether any page is open."""
        return bool(self._views)

    async def update(self, request: UpdateRequest, who: str = "") -> Mapping[str, Any]:
        """Return what is new for a page opened by `who`; a page whose view was closed gets a new view.

        Raises:
            BadInput: if too many pages are open.
        """
        view = self._views.get(request.view)
        if view is None:
            view = self._open()
            view.who = who
            if before := next((state for state in self._past if state.id == request.view and state.who == who), None):
                self._past.remove(before)
                view.picks = before.picks
            request = replace(request, seen={})
        return await view.update(request)

    def close(self) -> None:
        """Answer all pages that wait for news, because the server ends."""
        for view in self._views.values():
            view.close()

    async def answer(self, asked: Mapping[str, Any]) -> Mapping[str, Any]:
        """Answer a page's other requests: a large part by its key, storing its picks, or closing its view.

        Raises:
            NotFound: if the view or the part no longer exists.
            BadInput: for an invalid request.
        """
        view = self._views.get(str(asked.get("view")))
        if view is None:
            raise NotFound("This is no longer shown.")
        if asked.get("closed"):
            self._forget(view)
            return {}
        if "picked" not in asked:
            return _part(view.chunks, str(asked.get("key")), asked.get("from", 0))
        await view.pick(picks_of(asked["picked"]))
        if self._in_browser:
            await asyncio.to_thread(keep, self.acting.at, self._subject, view.picks)
        return {"picked": [visible(pick.summary()) for pick in view.picks]}

    def states(self) -> Sequence[PageState]:
        """Return what the pages show, and the last state of recently closed pages."""
        return [*(view.state(self._subject) for view in self._views.values()), *self._past]

    @property
    def _subject(self) -> str:
        return "the robot now" if self._source.is_live else f"the recording {self._source.title}"

    async def stop(self) -> Mapping[str, Any]:
        """Press the stop button."""
        return await press(self.acting, self._robot)

    def _open(self) -> View:
        if len(self._views) >= MOST_VIEWS and not self._give_up_oldest():
            raise BadInput(f"{MOST_VIEWS} pages are open already.", "Close one; it is given up ten seconds later.")
        chunks = Chunks()
        page = PageContext(self._title, self._source, self.acting, chunks, self._prefixes)
        view = View(self._robot, self._source, [kind(page) for kind in panel_types()], chunks)
        self._views[view.id] = view
        self._tasks.start_soon(self._run, view)
        return view

    def _give_up_oldest(self) -> bool:
        """Close the view with the oldest request, if it is older than `_UNWANTED_S`; return whether it was closed."""
        oldest = min(self._views.values(), key=lambda view: view.asked_at)
        if monotonic() - oldest.asked_at < _UNWANTED_S:
            return False
        self._forget(oldest)
        return True

    def _forget(self, view: View) -> None:
        if self._views.pop(view.id, None):
            self._past.append(view.state(self._subject, is_open=False))
            view.close()

    async def _run(self, view: View) -> None:
        try:
            await view.run()
        finally:
            self._forget(view)


async def press(acting: Acting, robot: Robot) -> Mapping[str, Any]:
    """Press the stop button, and return the outcome for a page."""
    stopped = await acting.stop(robot)
    return {
        "summary": stopped.summary(),
        "is_all_well": stopped.is_all_well,
        "servers": [asdict(one) for one in stopped.servers],
        "zeros": stopped.zeros,
        "latched": stopped.latched,
        "problems": stopped.problems,
    }


def panel_in_words(panel: Panel, content: Content | None, now_ns: int) -> str:
    """Return one line for the model: what a panel shows, and how old what is from before."""
    if content is None:
        return f"{panel.name}: nothing yet"
    old = [str(one) for one in content.get("old") or ()]
    if content.get("from_before"):
        old.append(FromBefore.of(1, round(content["at_s"] * 1e9), now_ns).age)
    told = filter(None, (panel.words(content), *old[:MOST_NAMED], str(content.get("why") or "")))
    return f"{panel.name}: {'; '.join(told) or 'nothing'}"


def _part(chunks: Chunks, key: str, begin: Any) -> Mapping[str, Any]:
    """Return part of the data under this key, in base64; `next` is where the rest begins."""
    found = chunks.find(key)
    if found is None:
        raise NotFound("This is no longer shown.")
    if not isinstance(begin, int) or not 0 <= begin <= len(found):
        raise BadInput("The beginning is outside the data.")
    end = min(begin + _PART_BYTES, len(found))
    bulk = base64.b64encode(found[begin:end]).decode("ascii")
    return {"key": key, "bulk": bulk, "next": end if end < len(found) else None}


def update_request(arguments: Mapping[str, Any]) -> UpdateRequest:
    """Parse a page's JSON into a request. Raises `BadInput` if it is not valid."""
    try:
        panels = {str(name): str(chosen)[:_MOST_TOPIC] for name, chosen in dict(arguments["panels"]).items()}
        seen = {str(name): int(number) for name, number in dict(arguments.get("seen") or {}).items()}
        at_s = arguments.get("at_s")
        return UpdateRequest(
            view=str(arguments.get("view", "")),
            panels=panels,
            seen=seen,
            wait_ms=max(0, int(arguments.get("wait_ms", 0))),
            at_s=None if at_s is None else _time(at_s),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput("This is not a valid request of the page.", str(error)) from error


def _time(value: Any) -> float:
    at_s = float(value)
    if not 0 <= at_s < 1e11:
        raise ValueError(f"{at_s} is not a time")
    return at_s
