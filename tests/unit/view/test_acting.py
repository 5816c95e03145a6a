"""What the page is told of who acts: stops that are not confirmed, and what was done at the time of a recording."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from ros2_mcp.bags.qos import qos_text
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.compose.robot import robot_for, store_for
from ros2_mcp.guard.approvals import Approvals
from ros2_mcp.guard.audit import Audit
from ros2_mcp.guard.chain import GENESIS, file_name, line_of
from ros2_mcp.guard.consent import AUDIT, audit_folder
from ros2_mcp.guard.modes import Modes
from ros2_mcp.guard.operating import Operated, StopAnswer, operating
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.qos import QoS
from ros2_mcp.model.samples import Sample
from ros2_mcp.model.times import iso_time
from ros2_mcp.ops.memory.record import CALLS
from ros2_mcp.ops.sources.kinds import Sources
from ros2_mcp.ops.sources.live import Live
from ros2_mcp.robot import Robot
from ros2_mcp.settings import Settings
from ros2_mcp.view.acting import Acting
from ros2_mcp.view.acts import acts_in, presses_as_one
from ros2_mcp.view.look import Content, Look
from ros2_mcp.view.panels.agent import AgentPanel
from support.made_windows import encoded
from support.panels import page_of
from support.room_bag import START_NS, room_bag

SECOND_NS = 10**9
DRIVE = {"kind": "act", "tool": "ros2_topic_publish", "verb": "repeat", "name": "/cmd_vel", "duration_s": 3.0}


@asynccontextmanager
async def server(folder: StateFolder, answer: StopAnswer) -> AsyncGenerator[None, None]:
    """One that gives this answer to a stop, and has a recording under way."""
    log = Audit(folder.make)

    async def stop(by: str) -> StopAnswer:
        folder.latch().set(by=by, reason="stopped by a person")
        return answer

    job = {"id": "recording_1", "kind": "recording", "for_s": 3, "at_most_s": None, "doing": "2 topics into run"}
    operated = Operated(
        robot="hall-3",
        policy=Policy(),
        approvals=Approvals(changed=lambda kind, fields: log.note(kind, **fields)),
        modes=Modes(folder, policy="p"),
        audit=log,
        latch=folder.latch(),
        stop=stop,
        status=lambda: {"moves": ["/cmd_vel"], "jobs": [job]},
    )
    async with operating(folder, operated):
        yield
    log.close()


async def recorded(bag: Path) -> tuple[Robot, Any]:
    settings = Settings(bag=bag)
    store = store_for(settings)
    robot = robot_for(settings, store)
    return robot, await Sources(robot, store).open()


async def test_a_stop_that_is_not_confirmed_is_told_as_an_alarm(tmp_path: Path) -> None:
    robot, _ = await recorded(room_bag(tmp_path / "room"))
    for number, (is_doubted, words) in enumerate(((True, "NOT confirmed: /base also publishes."), (False, "Stopped."))):
        folder = StateFolder(tmp_path / f"state{number}")
        async with server(folder, StopAnswer(words, is_doubted)):
            stopped = await Acting(folder).stop(robot)
        (one,) = stopped.servers
        assert (one.answered, one.said, one.is_doubted) == (True, words, is_doubted)
        assert stopped.is_all_well is not is_doubted
        assert ("The robot MAY STILL MOVE: look at it" in stopped.summary()) is is_doubted


async def test_a_stop_that_is_not_confirmed_says_whether_the_robot_was_seen_to_stand(tmp_path: Path) -> None:
    robot, _ = await recorded(room_bag(tmp_path / "room"))
    folder = StateFolder(tmp_path / "state")
    async with server(folder, StopAnswer("NOT confirmed: /logger did not acknowledge.", True, is_observed_still=True)):
        stopped = await Acting(folder).stop(robot)
    assert not stopped.is_all_well
    assert "The robot appears to stand still, but this is NOT confirmed" in stopped.summary()


def test_an_answer_to_a_request_is_told_with_what_it_is_about() -> None:
    granted = {"kind": "granted", "approval": "AB12", "by": "operator", "for_s": 60, "what": "publishing on /cmd_vel"}
    lines = [{"kind": "approved", "approval": "CD34", "by": "operator"}, granted]
    told = [(act["kind"], act["name"], act.get("reason")) for act in acts_in(lines)]
    assert told == [("approved", "CD34", None), ("granted", "AB12", "publishing on /cmd_vel")]


def test_that_the_latch_was_found_set_is_told_once_until_it_is_reset() -> None:
    cause = {"by": "operator", "reason": "a person stopped the robot"}
    lines = [{"kind": "latched", **cause}, {"kind": "latched", **cause}, {"kind": "reset", "by": "operator"}]
    told = [act["kind"] for act in acts_in([*lines, *lines, {"kind": "latched", "by": "watchdog"}])]
    assert told == ["latched", "reset", "latched", "reset", "latched"]


def test_one_press_of_the_button_is_one_act_also_of_two_servers() -> None:
    def line(kind: str, second: float, by: str = "operator") -> dict[str, Any]:
        return {"kind": kind, "by": by, "time": iso_time(START_NS + round(second * SECOND_NS))}

    press = [line("latched", 0.1), line("stop", 0.2), line("stop", 0.3), line("stopped", 2.0), line("stopped", 2.4)]
    lines = [*press, line("reset", 5), line("latched", 7, "watchdog"), line("stop", 60), line("stop", 60.2, "agent")]
    told = [(act["kind"], act["by"], act.get("outcome")) for act in presses_as_one([*acts_in(lines)])]
    assert told == [
        ("stop", "operator", "stopped, latched"),
        ("reset", "operator", None),
        ("latched", "watchdog", None),
        ("stop", "operator", None),
        ("stop", "agent", None),
    ]
    (doubted,) = presses_as_one([*acts_in([*press, {**line("stopped", 2.5), "confirmed": False}])])
    assert doubted["outcome"] == "not confirmed, latched"
    assert len(presses_as_one([*acts_in([{**one, "time": "x"} for one in press])])) == len(press)  # of a recording


async def test_a_job_that_has_ended_is_told_as_an_act(tmp_path: Path) -> None:
    robot, source = await recorded(room_bag(tmp_path / "room"))
    folder = StateFolder(tmp_path / "state")
    now_s = time.time()
    panel = AgentPanel(page_of(Live(robot), Acting(folder)), now_s=lambda: now_s)
    async with server(folder, StopAnswer("Stopped.", is_doubted=False)):
        shown = await panel.show(Look(robot, source))
    assert shown and shown["acts"] == []
    now_s += 3.0
    shown = await panel.show(Look(robot, source))
    assert shown
    told = [(act["kind"], act["verb"], act["name"], act["reason"]) for act in shown["acts"]]
    assert told == [("ended", "recording", "recording_1", "2 topics into run")]


async def test_what_runs_and_is_no_command_is_told(tmp_path: Path) -> None:
    folder = StateFolder(tmp_path / "state")
    async with server(folder, StopAnswer("Stopped.", is_doubted=False)):
        (row,) = await Acting(folder).servers()
    assert [job["doing"] for job in row["jobs"]] == ["2 topics into run"]


async def acts_at(panel: AgentPanel, robot: Robot, source: Any, seconds: float) -> Content:
    shown = await panel.show(Look(robot, source.part(START_NS, START_NS + round(seconds * SECOND_NS))))
    assert shown
    return shown


async def test_a_recording_shows_the_audit_of_its_time(tmp_path: Path) -> None:
    robot, source = await recorded(room_bag(tmp_path / "room"))
    folder = StateFolder(tmp_path / "state")
    audited(folder.make() / AUDIT)
    panel = AgentPanel(page_of(source, Acting(folder)))
    before, during, after = [await acts_at(panel, robot, source, seconds) for seconds in (0.5, 2.0, 5.5)]
    assert [act.get("outcome") for act in before["acts"]] == []
    assert [act.get("outcome") for act in during["acts"]] == [""]
    assert [(act["name"], act.get("outcome")) for act in after["acts"]] == [("/cmd_vel", "done")]
    assert "from the audit of state on this machine" in after["origin"]


def audited(folder: Path) -> None:
    """Lines long before, at one and at four seconds of the recording, and long after."""
    folder.mkdir()
    seconds = ((-1e6, {**DRIVE, "name": "/old"}), (1, DRIVE), (4, {"kind": "outcome", "of": 2, "outcome": "done"}))
    seq, prev = 1, GENESIS
    with (folder / file_name(1)).open("wb") as file:
        for at, fields in (*seconds, (1e6, {**DRIVE, "name": "/new"})):
            line, prev = line_of(seq, prev, {"time": iso_time(START_NS + round(at * SECOND_NS)), **fields})
            file.write(line)
            seq += 1


async def test_a_recording_that_has_what_the_agent_did_shows_that(tmp_path: Path) -> None:
    bag = tmp_path / "run"
    bag.mkdir()
    lines: Sequence[str] = [json.dumps({"time": "x", **DRIVE}), "no line", "[]"]
    writer = BagWriter(bag, bag.name)
    writer.add_topic(StoredTopic(CALLS, "std_msgs/msg/String", None, "", "", qos_text([QoS()])))
    for number, line in enumerate(lines, 1):
        at_ns = START_NS + number * SECOND_NS
        writer.write(CALLS, Sample(at_ns, at_ns, number, encoded("std_msgs/msg/String", {"data": line})))
    writer.close()
    robot, source = await recorded(bag)
    panel = AgentPanel(page_of(source, Acting(StateFolder(tmp_path / "state"))))
    shown = await asyncio.wait_for(acts_at(panel, robot, source, 3.0), 30.0)
    assert [(act["name"], act["time"]) for act in shown["acts"]] == [("/cmd_vel", iso_time(START_NS + SECOND_NS))]
    assert shown["origin"] == "At the time shown, as recorded in /agent/calls"


def test_a_call_that_waited_is_told_once_with_how_it_was_answered() -> None:
    waits = {"kind": "waits", "verb": "publish", "name": "/cmd_vel"}
    asked = [{**waits, "approval": name, "reason": "this waits"} for name in ("AB12", "AB12", "CD34", "EF56", "GH78")]
    answers = [
        {"kind": "approved", "approval": "AB12", "by": "operator"},
        {"kind": "denied", "approval": "CD34", "by": "operator"},
        {"kind": "granted", "approval": "IJ90", "of": "EF56", "what": "publish /cmd_vel"},
    ]
    done = {"kind": "act", "verb": "publish", "name": "/cmd_vel", "approval": "AB12", "seq": 9}
    told = [act for act in acts_in([*asked, *answers, done]) if act["kind"] in ("waits", "act")]
    assert [(act["approval"], act["outcome"], act["name"]) for act in told] == [
        *(("AB12", "approved", "/cmd_vel"), ("CD34", "denied", "/cmd_vel"), ("EF56", "granted", "/cmd_vel")),
        *(("GH78", "", "/cmd_vel"), ("AB12", "", "/cmd_vel")),
    ]


async def test_a_call_that_nobody_has_answered_waits_no_longer_once_its_server_has_ended(tmp_path: Path) -> None:
    robot, source = await recorded(room_bag(tmp_path / "room"))
    folder = StateFolder(tmp_path / "state")
    log = Audit(lambda: audit_folder(folder))
    log.note("waits", approval="AB12", verb="publish", name="/cmd_vel")
    await log.written()
    began_s, later_s = time.time(), 0.0
    panel = AgentPanel(page_of(Live(robot), Acting(folder)), now_s=lambda: began_s + later_s)
    ends: list[str] = []
    for later_s in (0.0, 1.0, 3.0):  # noqa: B007 - the panel's clock
        shown = await panel.show(Look(robot, source))
        assert shown
        ends += [act["outcome"] for act in shown["acts"] if act["kind"] == "waits"]
    log.close()
    assert ends == ["", "", "not answered"]
