"""Views: what each open page looks at, kept up to date while it asks, and given up when it does not."""

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
from ros2_mcp.ops.sources.newest import NewestOfRobot
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot import Robot
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.look import Chunks, Content, Look, PageContext, Panel
from ros2_mcp.view.panels import panel_types
from ros2_mcp.view.panels.image import ImagePanel
from ros2_mcp.view.picks import Pick, keep, picks_of

MOST_VIEWS = 4
"""Pages at once: somebody has it open on a screen and a phone, and forgets to close one."""
MOST_WAIT_MS = 1500
"""Of one update: hosts of chats pass calls on through one or two processes that have time limits of their own."""
IDLE_S = 10.0
"""A view that nobody has asked for so long is given up: a page that is hidden or gone costs nothing."""
_UNWANTED_S = 4.0
"""A panel that was not asked for so long is not made: it is hidden, or off the screen."""
_FAILED_S = 1.0
"""Between two tries of a panel that cannot be shown."""
_MOST_TOPIC = 300
_PART_BYTES = 300_000
"""Of a large part in one answer: a third more in base64, which is what chat hosts are known to pass on."""
_MOST_PAST = 4
"""Pages that were given up, of which it is still told what they showed."""
_ROUNDED_NS = 1000
"""A page's time is a float, some 100 ns too early or late: the message at which it is meant to stand is shown."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UpdateRequest:
    """What a page asks for: its view (empty: a new one), the panels with what is chosen in each, what it has `seen`
    of each, how long it waits for news, and of a recording the time that is shown (Unix time, s).
    """

    view: str = ""
    panels: Mapping[str, str] = field(default_factory=dict[str, str])
    seen: Mapping[str, int] = field(default_factory=dict[str, int])
    wait_ms: int = 0
    at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PageState:
    """What one page shows, or showed when it was given up: a line for each panel that is seen, and what was picked.

    `asked_at` is when it last asked (Unix time, s), `who` the client whose page it is.
    """

    id: str
    who: str
    subject: str
    is_open: bool
    asked_at: float
    shows: Sequence[str]
    picks: Sequence[Pick]


class Tasks(Protocol):
    """Where work is begun that goes on beside the calls, such as a task group."""

    def start_soon(self, work: Callable[..., Coroutine[Any, Any, None]], /, *arguments: object) -> object:
        """Begins it."""
        ...


@dataclass(eq=False)
class _Shown:
    """One panel with what it shows: `number` grows with each change."""

    panel: Panel
    chosen: str = ""
    number: int = 0
    content: Content | None = None
    asked_at: float = 0.0
    asked: asyncio.Event = field(default_factory=asyncio.Event)
    scope: anyio.CancelScope | None = None

    def wake(self, *, anew: bool) -> None:
        """It is asked for; `anew`: what is under way is about something else."""
        self.asked_at = monotonic()
        if anew:
            self.content = None
        if anew and self.scope:
            self.scope.cancel()
        self.asked.set()


class View:
    """One open page."""

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
        """Answers who waits for news."""
        self._is_closed = True
        self._news.set()

    async def run(self) -> None:
        """Until nobody has asked for it for a while."""
        async with anyio.create_task_group() as tasks:
            for shown in self._shown.values():
                tasks.start_soon(self._keep, shown)
                if self._live:
                    tasks.start_soon(self._beside, shown.panel)
            while monotonic() - self.asked_at < IDLE_S and not self._is_closed:
                await anyio.sleep(0.5)
            tasks.cancel_scope.cancel()

    async def update(self, request: UpdateRequest) -> Mapping[str, Any]:
        """The panels that have something newer than what the page has seen; waits for the first one."""
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
        """What it shows."""
        until_ns = self._until_ns
        at = f", at {iso_time(until_ns)}" if until_ns is not None else ""
        seen = [shown for shown in self._shown.values() if shown.asked_at > self.asked_at - _UNWANTED_S]
        return PageState(
            id=self.id,
            who=self.who,
            subject=f"{subject}{at}",
            is_open=is_open,
            asked_at=self._told_at,
            shows=[_told(one.panel, one.content) for one in seen if one.panel.name != "robot"],
            picks=self.picks,
        )

    async def pick(self, picks: Sequence[Pick]) -> None:
        """Notes what is picked, in place of what was before; a box that is new, with the depth there."""
        found: list[Pick] = []
        for pick in picks:
            old = next((one for one in self.picks if one.is_same_box(pick)), None)
            if pick.kind == "box" and not old:
                old = pick.with_depth(*await self._images.depth_within(pick.topic, pick.time, pick.pixels))
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
        except Exception:  # whatever one panel meets: the others, and the button, go on
            _logger.exception("what the panel %s does beside failed", panel.name)

    async def _keep(self, shown: _Shown) -> None:
        """Shows one panel again and again, while it is asked for."""
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
        except Exception:  # whatever one panel meets: the others, and the button, go on
            _logger.exception("the panel %s failed", shown.panel.name)
            found = {"why": "This panel failed; the log of ros2-mcp view says how.", "failed": True}
        if found is None:
            return None
        told, _ = visible_json({name: value for name, value in found.items() if name != "bulk"})
        return {**told, "bulk": found["bulk"]} if "bulk" in found else told


class Views:
    """All open pages of one robot or recording. `acting` knows who acts on it.

    What is picked `in_browser` is kept in the state folder, where the agent's server finds it. Below `prefixes` are
    packages with meshes, besides those that this process sees anyway.
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
        """Whether a page asks."""
        return bool(self._views)

    async def update(self, request: UpdateRequest, who: str = "") -> Mapping[str, Any]:
        """What is new for a page, which `who` has opened; a page whose view was given up gets a new one.

        Raises:
            BadInput: if there are too many.
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
        """Answers all pages that wait for news: the server ends."""
        for view in self._views.values():
            view.close()

    async def answer(self, asked: Mapping[str, Any]) -> Mapping[str, Any]:
        """What else a page asks: a large part by its key, or to note what was picked (all of it), or its end.

        Raises:
            NotFound: if the view or the part is no longer there.
            BadInput: for what no page asks.
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
        """What the pages show, and the last ones that were given up."""
        return [*(view.state(self._subject) for view in self._views.values()), *self._past]

    @property
    def _subject(self) -> str:
        return "the robot now" if self._source.is_live else f"the recording {self._source.title}"

    async def stop(self) -> Mapping[str, Any]:
        """Presses the button."""
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
        """Whether a view was given up that has not asked for longer than a page that is seen ever waits."""
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
    """Presses the button, for a page."""
    stopped = await acting.stop(robot)
    return {
        "summary": stopped.summary(),
        "is_all_well": stopped.is_all_well,
        "servers": [asdict(one) for one in stopped.servers],
        "zeros": stopped.zeros,
        "latched": stopped.latched,
        "problems": stopped.problems,
    }


def _told(panel: Panel, content: Content | None) -> str:
    """One line for the model: what a panel shows, if it shows anything yet."""
    if content is None:
        return f"{panel.name}: nothing yet"
    told = filter(None, (panel.words(content), str(content.get("why") or "")))
    return f"{panel.name}: {'; '.join(told) or 'nothing'}"


def _part(chunks: Chunks, key: str, begin: Any) -> Mapping[str, Any]:
    """A part of what was offered under this key, packed with zlib, in base64; `next` is where the rest begins."""
    found = chunks.find(key)
    if found is None:
        raise NotFound("This is no longer shown.")
    if not isinstance(begin, int) or not 0 <= begin <= len(found):
        raise BadInput("A part begins within the whole.")
    end = min(begin + _PART_BYTES, len(found))
    bulk = base64.b64encode(found[begin:end]).decode("ascii")
    return {"key": key, "bulk": bulk, "next": end if end < len(found) else None}


def update_request(arguments: Mapping[str, Any]) -> UpdateRequest:
    """The request that a page's JSON is. Raises `BadInput` for what is none."""
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
        raise BadInput("This is no question of the page.", str(error)) from error


def _time(value: Any) -> float:
    at_s = float(value)
    if not 0 <= at_s < 1e11:
        raise ValueError(f"{at_s} is no time")
    return at_s
