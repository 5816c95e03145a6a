"""The page where its server fails, is slow or says too much; hidden; for hours."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import FULL, until
from support.browser import CHROMIUM, Page, browsing
from support.scripted_view import Answer, ScriptedView, good, scripted, updated
from support.viewing import STOP, text

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")

HOURS, TIMES_FASTER, GROWN_BYTES, GROWN_NODES = 3, 100, 2_000_000, 500
FASTER = f"""(() => {{
  const [timeout, interval, now, date] = [setTimeout, setInterval, performance.now.bind(performance), Date.now];
  const [began, first] = [now(), date()];
  window.setTimeout = (work, ms = 0) => timeout(work, ms / {TIMES_FASTER});
  window.setInterval = (work, ms = 0) => interval(work, ms / {TIMES_FASTER});
  performance.now = () => began + (now() - began) * {TIMES_FASTER};
  Date.now = () => first + (now() - began) * {TIMES_FASTER};
}})()"""
"""The clock of the page."""
SHARED = ("space", "plot", "frames", "map", "values")
DRAWN = {"plot": "#plot .sheet", "space": "#space canvas"}
LIVE = f"{text('#state')} === 'live'"


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browsing(graphics=FULL) as page:
        page.look()
        yield page


@pytest.fixture
def view(page: Page) -> Iterator[ScriptedView]:
    with scripted() as view:
        page.complaints.clear()
        page.open(view.address)
        page.until(LIVE)
        yield view
        page.ask("Page.navigate", url="about:blank")


def test_a_server_that_fails_is_told_and_the_page_goes_on_when_it_answers(page: Page, view: ScriptedView) -> None:
    failures: tuple[Answer, ...] = (
        (500, "text/plain", b"out of order"),
        (200, "application/json", b"{"),
        *(good(wrong) for wrong in (None, {"panels": None})),
    )
    for failure in failures:
        view.answers = lambda _, failure=failure: failure
        page.until(f"{text('#state')}.includes('does not answer')")
        view.answers = lambda asked: good(updated(asked, view.asked))
        page.until(LIVE)
    assert [one for one in page.complaints if "500" not in one] == []  # which the browser itself tells of the first


def test_before_the_first_answer_the_page_says_that_it_waits_and_claims_nothing(page: Page, view: ScriptedView) -> None:
    page.ask("Page.navigate", url="about:blank")
    view.answers = lambda _: good({"view": "scripted", "now_s": 1.7e9, "panels": {}})
    page.open(view.address)
    page.until(f"{text('#state')} === 'connecting'")
    assert page.run(text("#moves")) == ""
    told = [page.run(text(f"#{panel} .why")) for panel in ("map", "image", "agent", "values", "log")]
    assert told == ["Waiting for the first answer."] * 5
    view.answers = lambda asked: good(updated(asked, view.asked))
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")
    page.until("[...document.querySelectorAll('.why')].every(one => one.hidden || !one.offsetParent)")


def test_after_a_stop_the_page_says_only_what_it_is_told_from_then_on(page: Page, view: ScriptedView) -> None:
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")
    is_released, is_held = threading.Event(), threading.Event()

    def held(asked: dict[str, Any]) -> Answer:
        is_held.set()
        is_released.wait(20.0)
        return good(updated(asked, view.asked))

    view.answers = held
    assert is_held.wait(20.0)
    page.run(STOP)
    page.until(f"{text('#said')}.includes('1 of 1 server')")
    page.until(f"{text('#moves')} === ''")
    is_released.set()
    page.until(f"{text('#moves')}.startsWith('agent drives /cmd_vel')")


def test_what_was_sent_before_the_server_subscribed_says_so_with_its_age(page: Page, view: ScriptedView) -> None:
    def answer(asked: dict[str, Any]) -> Answer:
        update = updated(asked, view.asked)
        for name in ("values", "image"):
            if name in update["panels"]:
                update["panels"][name] |= {"at_s": update["now_s"] - 40.0, "from_before": True}
        if "map" in update["panels"]:
            update["panels"]["map"]["old"] = ["goal /goal_pose 8.2 s old, from before"]
        return good(update)

    view.answers = answer
    for name in ("values", "image"):
        page.until(f"/\\b4\\d s old, from before$/.test({text(f'#{name} .age')})")
    page.until(f"{text('#map .foot')} === 'goal /goal_pose 8.2 s old, from before.'")
    view.answers = lambda asked: good(updated(asked, view.asked))
    page.until(f"{text('#values .age')}.endsWith('now') && document.querySelector('#map .foot').hidden")


def test_nonsense_in_panels_is_told_and_forgotten_with_the_next_answer(page: Page, view: ScriptedView) -> None:
    wrong: list[dict[str, Any]] = [
        *({"why": why} for why in (5, [[]])),
        {"value": {"a": [None]}, "lines": 5, "acts": 5, "bulk": 5, "robot": 5, "grid": 5, "servers": 5},
        {"bulk": "!", "paths": [{}], "layers": [1], "servers": [{}], "topics": 5, "lines": [{}], "value": "x"},
        {"bulk": ["!"], "grid": {"key": 5}, "robot": {}, "goals": [{}], "acts": [None], "missing": [5], "topics": [5]},
    ]
    for one in wrong:

        def answer(asked: dict[str, Any], one: dict[str, Any] = one) -> Answer:
            update = updated(asked, view.asked)
            update["panels"] = {name: {"number": view.asked, **one} for name in update["panels"]}
            return good(update)

        view.answers, before = answer, view.asked
        assert wait(lambda before=before: view.asked > before + 2), one
        view.answers, before = lambda asked: good(updated(asked, view.asked)), view.asked
        newest = f"Math.max(...({text('#log')}.match(/(?<=line )[0-9]+/g) ?? [0]))"
        page.until(f"{LIVE} && {newest} > {before + 1}")  # of one that was there for a moment nobody would know
    assert page.complaints == []


def wait(check: Any, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not check() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(check())


def test_slow_and_huge_answers_are_waited_for_one_at_a_time(page: Page, view: ScriptedView) -> None:
    def huge(asked: dict[str, Any]) -> Answer:
        time.sleep(0.3)
        update = updated(asked, view.asked)
        lines = [{"time": "", "level": "ERROR", "node": "n" * 1000, "text": "W" * 2000}] * 500
        value = {f"field{number}": "x" * 500 for number in range(1000)}
        update["panels"]["log"]["lines"], update["panels"]["values"]["value"] = lines, value
        update["panels"]["agent"]["acts"][0]["reason"] = "y" * 1_000_000
        return good(update)

    view.answers = huge
    page.until(
        f"{text('#log')}.length > 1000000 && {text('#values')}.length > 400000 && {text('#agent')}.length > 900000"
    )
    before = view.asked
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert view.asked <= before + 2  # it is answered between two of them
    assert view.most_at_once == 1
    assert page.complaints == []


def test_a_hidden_page_asks_nothing(page: Page, view: ScriptedView) -> None:
    page.run("Object.defineProperty(document, 'hidden', {get: () => window.isHidden}), window.isHidden = true")
    until(lambda: view.asked == asked_after_a_while(page, view))  # what was under way has ended
    before = view.asked
    assert asked_after_a_while(page, view) == before
    page.run("window.isHidden = false")
    assert wait(lambda: view.asked > before + 2)


def asked_after_a_while(page: Page, view: ScriptedView) -> int:
    """How often a page has asked, once its own clock has gone on by a time in which it asks several times."""
    page.run("new Promise(done => setTimeout(done, 600))")
    return view.asked


@pytest.mark.full
def test_the_page_does_not_grow_in_hours(page: Page) -> None:
    with scripted() as view:
        page.ask("Page.addScriptToEvaluateOnNewDocument", source=FASTER)
        view.answers = lambda asked: good(updated(asked, view.asked))
        page.open(view.address)
        seconds = HOURS * 3600 / TIMES_FASTER
        looked_at(page, seconds * 0.2)
        early, updates = used(page), view.asked
        looked_at(page, seconds * 0.8)
        late = used(page)
        drawn = {panel: page.run(f"document.querySelector('{at}').ariaLabel") for panel, at in DRAWN.items()}
    assert "sine" in drawn["plot"] and "6000 points" in drawn["space"], drawn
    print(
        f"\n{HOURS} h of simulated clock, {view.asked} updates ({updates} before the first look): {early} then {late}"
    )
    assert late[0] - early[0] < GROWN_BYTES
    assert late[1] - early[1] < GROWN_NODES


def looked_at(page: Page, seconds: float) -> None:
    """For so long, each of the panels that share a place in turn."""
    ends_at = time.monotonic() + seconds
    for panel in cycle(SHARED):
        if time.monotonic() > ends_at:
            break
        page.run(f"document.querySelector('[aria-controls={panel}]').click()")
        time.sleep(min(3.0, seconds / 10))


def used(page: Page) -> tuple[float, float]:
    """Bytes of the heap and nodes of the document, once what is not needed has gone: nodes that scripts held go only
    with a collection after the one that frees these.
    """
    before, nodes = math.inf, math.inf
    for _ in range(10):
        page.ask("HeapProfiler.collectGarbage")
        before, nodes = nodes, page.ask("Memory.getDOMCounters")["nodes"]
        if nodes >= before:
            break
    return page.ask("Runtime.getHeapUsage")["usedSize"], nodes
