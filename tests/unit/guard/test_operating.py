"""The operator's socket: who may, what the screen shows, and that a key answers only what was read."""

from __future__ import annotations

import asyncio
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ros2_mcp.commands.audit import audit as audit_command
from ros2_mcp.commands.operate import Choice, folder_of, granted, operate, servers_in, shown
from ros2_mcp.guard import operating as operating_module
from ros2_mcp.guard.approvals import Approvals
from ros2_mcp.guard.audit import Audit
from ros2_mcp.guard.chain import entries, verify
from ros2_mcp.guard.exact import ExactCommand
from ros2_mcp.guard.modes import Modes
from ros2_mcp.guard.operating import Operated, StopAnswer, operating
from ros2_mcp.guard.operators import connected, listen_at, may_operate
from ros2_mcp.guard.policy import Policy
from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.commands import LOCAL, Publish
from ros2_mcp.model.errors import ApprovalNeeded, BadInput, NotFound, Refused, RobotError
from ros2_mcp.model.qos import Choice as QosChoice
from ros2_mcp.model.qos import QoS


def drive(x: float = 0.2) -> ExactCommand:
    value = {"linear": {"x": x, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
    choice = QosChoice(QoS("reliable", "volatile", depth=1), "")
    kind = "geometry_msgs/msg/Twist"
    return ExactCommand.of(
        Publish(principal=LOCAL, name="/cmd_vel", type=kind, value=value, choice=choice, wait_match_s=1.0)
    )


def _nobody(_: int) -> bool:
    return False


@asynccontextmanager
async def served(
    path: Path, usual: StateFolder | None = None, name: str = "robot"
) -> AsyncGenerator[tuple[Operated, StateFolder], None]:
    """A server's part, in a folder whose path is longer than a socket's address may be."""
    folder = StateFolder(path / ("long" * 30) / name)
    log = Audit(folder.make)
    stopped: list[str] = []

    async def stop(by: str) -> StopAnswer:
        folder.latch().set(by=by, reason="stopped by a person")
        stopped.append(by)
        return StopAnswer("Stopped.", is_doubted=False)

    operated = Operated(
        robot="hall-3",
        policy=Policy(),
        approvals=Approvals(changed=lambda kind, fields: log.note(kind, **fields)),
        modes=Modes(folder, policy="p"),
        audit=log,
        latch=folder.latch(),
        stop=stop,
    )
    async with operating(folder, operated, usual):
        yield operated, folder
    log.close()


async def asked(folder: StateFolder, *words: str) -> tuple[int, str]:
    """What `ros2-mcp operate` prints, in a process of its own."""
    return await printed("operate", "--state", str(folder.path), *words)


async def printed(*words: str) -> tuple[int, str]:
    """What `ros2-mcp` prints, in a process of its own."""
    command = [sys.executable, "-m", "ros2_mcp", *words]
    process = await asyncio.create_subprocess_exec(*command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    text, _ = await process.communicate()
    assert process.returncode is not None
    return process.returncode, text.decode()


def waiting(approvals: Approvals, exact: ExactCommand) -> str:
    with pytest.raises(ApprovalNeeded) as needed:
        approvals.require(exact)
    return needed.value.request_id


def run(work: Callable[[], Any]) -> None:
    asyncio.run(work())


def test_an_operator_reads_and_approves_in_another_process(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (operated, folder):
            request_id = waiting(operated.approvals, drive())
            code, text = await asked(folder)
            assert code == 0
            assert "Publish on /cmd_vel (geometry_msgs/msg/Twist), once." in text
            assert "linear.x 0.2 m/s; every other value is 0 or empty." in text
            code, text = await asked(folder, "approve", request_id.lower())
            assert (code, text) == (0, f"{request_id} is approved, once.\n")
            assert operated.approvals.require(drive()) == request_id
            code, text = await asked(folder, "approve", request_id)
            assert code == 1
            assert "No request" in text
            other = waiting(operated.approvals, drive(0.3))
            assert (await asked(folder, "deny", other))[0] == 0
            with pytest.raises(Refused, match="denied"):
                operated.approvals.require(drive(0.3))
        kinds = [entry["kind"] for entry in entries(folder.path)]
        assert kinds == ["asked", "approved", "asked", "denied"]
        assert all(entry["by"].startswith("operator ") for entry in entries(folder.path) if entry["kind"] != "asked")
        assert verify(folder.path).faults == []

    run(work)


def test_an_operator_stops_and_resets_and_what_was_set_since_is_not_reset(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (operated, folder):
            assert (await asked(folder, "stop"))[1] == "Stopped.\n"
            assert folder.latch().look().is_set
            [server] = await asyncio.to_thread(servers_in, folder.path)
            seen = operated.latch.look().count
            folder.latch().set(by="watchdog", reason="it moves")
            with pytest.raises(RobotError, match="set again"):
                await asyncio.to_thread(server.do, "reset", seen=seen)
            assert folder.latch().look().is_set
            code, text = await asked(folder, "reset")
            assert code == 0
            assert "Nothing was started" in text
            assert not folder.latch().look().is_set
            server.close()

    run(work)


def test_a_grant_and_a_mode_are_changed_as_the_policy_allows(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (operated, folder):
            request_id = waiting(operated.approvals, drive())
            code, text = await asked(folder, "grant", request_id, "10m", "linear=0.25")
            assert (code, text[5:]) == (
                0,
                "is granted for 600 s: publish /cmd_vel (geometry_msgs/msg/Twist), linear at most 0.25.\n",
            )
            operated.approvals.require(drive(0.25))
            assert (await asked(folder, "revoke", text[:4]))[0] == 0
            waiting(operated.approvals, drive(0.25))
            assert (await asked(folder, "mode", "observe"))[1] == "The mode is observe; it was autonomous.\n"
            assert Modes(folder, policy="p").now == "observe"
            assert Modes(folder, policy="another").now == "autonomous"
            assert (await asked(folder, "mode", "wild"))[0] == 1

    run(work)


def test_the_policy_bounds_the_mode_and_nothing_but_the_operators_choice_is_kept(tmp_path: Path) -> None:
    modes = Modes(StateFolder(tmp_path), most="confirm", policy="p")
    with pytest.raises(BadInput, match="confirm at most"):
        modes.set("autonomous")
    modes.set("observe")
    (tmp_path / "mode.json").write_text("{")
    assert Modes(StateFolder(tmp_path), policy="p").now == "observe"
    (tmp_path / "mode.json").write_text('{"mode": "autonomous", "policy": "p"}')
    assert Modes(StateFolder(tmp_path), most="confirm", policy="p").now == "confirm"


def test_another_user_is_no_operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def work() -> None:
        monkeypatch.setattr(operating_module, "may_operate", _nobody)
        async with served(tmp_path) as (operated, folder):
            request_id = waiting(operated.approvals, drive())
            code, text = await asked(folder, "approve", request_id)
            assert code == 1
            assert "not an operator" in text
            waiting(operated.approvals, drive())
        assert "operator refused" in [entry["kind"] for entry in entries(folder.path)]

    run(work)


def test_operators_are_root_and_the_servers_user_where_no_group_says_otherwise() -> None:
    assert may_operate(0)
    assert may_operate(os.geteuid())
    assert not may_operate(54321)


def test_the_socket_is_for_nobody_else_and_one_that_a_dead_server_left_is_removed(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (_, folder):
            [path] = folder.path.glob("operate-*.sock")
            assert path.stat().st_mode & 0o777 == 0o600
            dead = folder.path / "operate-dead.sock"
            listen_at(dead, print).listener.close()
            [server] = await asyncio.to_thread(servers_in, folder.path)
            await asyncio.to_thread(server.do, "list")
            server.close()
            assert not dead.exists()
        assert not path.exists()
        with pytest.raises(NotFound):
            servers_in(folder.path)

    run(work)


def test_a_server_removes_what_killed_ones_left_and_leaves_those_that_listen(tmp_path: Path) -> None:
    """Also the links to them, and not one that hangs, whose queue of connections is full."""

    async def work() -> None:
        usual = StateFolder(tmp_path / "usual")
        async with served(tmp_path, usual) as (_, folder):
            (alive,) = operating_module.sockets_of(folder.path)
            for number in range(5):
                dead = folder.path / f"operate-dead{number}.sock"
                listen_at(dead, print).listener.close()
                (usual.path / dead.name).symlink_to(dead)
            (usual.path / "operate-gone.sock").symlink_to(folder.path / "operate-gone.sock")
            hanging = listen_at(folder.path / "operate-hangs.sock", print)
            hanging.listener.listen(0)
            waiting_there = connected(folder.path / "operate-hangs.sock")
            async with served(tmp_path, usual):
                left = set(operating_module.sockets_of(folder.path))
                assert {alive, folder.path / "operate-hangs.sock"} < left and len(left) == 3
                assert len(operating_module.sockets_of(usual.path)) == 2
            waiting_there.close()
            hanging.listener.close()
            assert (await asked(folder))[0] == 0

    run(work)


def test_where_the_kernel_tells_nothing_of_users_a_secret_that_only_its_user_can_read_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        monkeypatch.setattr(operating_module, "listen_at", partial(listen_at, by_secret=True))
        async with served(tmp_path) as (operated, folder):
            [path] = folder.path.glob("operate-*.sock")
            assert path.stat().st_mode & 0o777 == 0o600
            request_id = waiting(operated.approvals, drive())
            assert await asked(folder, "approve", request_id) == (0, f"{request_id} is approved, once.\n")

            port, secret = path.read_text().split()
            path.write_text(f"{port} {secret[::-1]}")
            stranger = await asyncio.to_thread(connected, path)
            await asyncio.to_thread(stranger.sendall, b'{"do": "stop"}\n')
            answer = await asyncio.to_thread(stranger.makefile("rb").readline)
            assert b"not an operator" in answer
            stranger.close()
            assert not folder.latch().look().is_set
        assert not path.exists()

    run(work)


def test_whatever_is_sent_is_answered_and_ends_nothing(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (_, folder):
            [server] = await asyncio.to_thread(servers_in, folder.path)
            for bad in ("{}", '{"do": "approve"}', '{"do": "grant", "id": "A", "for_s": "x"}', '{"do": 7}', "[]", "x"):
                server._connection.sendall(f"{bad}\n".encode())  # pyright: ignore
                assert b'"ok": false' in await asyncio.to_thread(server._lines.readline)  # pyright: ignore
            assert (await asyncio.to_thread(server.do, "list"))["robot"] == "hall-3"
            server.close()

    run(work)


def state(*requests: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "robot": "hall-3", "mode": "confirm", "latch": None, "audit": {"head": "7:abc", "failed": ""},
        "waiting": list(requests), "grants": [], **more,
    }  # fmt: skip


def request(number: int) -> dict[str, Any]:
    return {"id": f"A7K{number}", "nonce": f"n{number}", "age_s": 3, "left_s": 597, "summary": drive(number).summary()}


def test_the_screen_says_what_matters_first() -> None:
    latch = {"by": "ros2_stop by local", "reason": "stopped", "since": 0.0, "count": 1}
    lines = shown(state(request(1), request(2), latch=latch), 80, "A7K2")
    assert lines[0] == "hall-3   mode confirm   2 waiting   audit 7:abc"
    assert re.match(r"LATCHED \d+ min ago by ros2_stop by local: stopped", lines[1])
    assert lines[3].startswith("  A7K1   asked 3 s ago, 597 s left")
    assert lines[4:6] == [
        "    Publish on /cmd_vel (geometry_msgs/msg/Twist), once.",
        "    linear.x 1 m/s; every other value is 0 or empty.",
    ]
    assert [line for line in lines if "▶" in line] == ["▶ A7K2   asked 3 s ago, 597 s left"]
    assert all(len(line) <= 80 for line in lines)


def test_no_line_of_the_screen_is_longer_than_it_and_nothing_is_left_out() -> None:
    reason = " ".join(f"word{number}" for number in range(60))
    latch = {"by": "watchdog", "reason": reason, "since": 0.0}
    grants = [{"id": "7", "left_s": 5.0, "what": reason}]
    told = state(latch=latch, audit={"head": "1:x", "failed": reason}, grants=grants)
    for width in (40, 80, 100):
        lines = shown(told, width)
        assert max(map(len, lines)) <= width
        assert " ".join(" ".join(lines).split()).count(reason) == 3


def test_the_screen_says_what_this_server_moves() -> None:
    assert shown(state(moves=["/cmd_vel", "/navigate"]))[1] == "moves the robot now: /cmd_vel, /navigate"
    assert shown(state(moves=[]))[1] == "moves nothing now"


def test_a_key_answers_only_what_has_been_there_to_be_read() -> None:
    choice = Choice()
    choice.follow([request(1), request(2)], 9.0)
    assert not choice.is_read(99.0)  # nobody has chosen
    choice.move([request(1), request(2)], 1, 10.0)
    assert choice.chosen["id"] == "A7K1"
    assert not choice.is_read(10.1)
    assert choice.is_read(11.0)
    choice.follow([request(2)], 12.0)  # the first has gone: the key that was meant for it answers nothing
    assert not choice.is_read(99.0)
    choice.move([request(2), request(3)], -1, 13.0)
    assert choice.chosen["id"] == "A7K3"
    choice.follow([request(3), request(4)], 14.0)
    assert choice.is_read(14.1)
    choice.move([request(3), request(4)], 1, 15.0)
    assert choice.chosen["id"] == "A7K4"


def test_a_key_that_is_pressed_twice_approves_once_and_the_screen_says_that_the_server_has_ended(
    tmp_path: Path,
) -> None:
    async def work() -> None:
        screen, terminal = os.openpty()
        try:
            async with served(tmp_path) as (operated, folder):
                first = waiting(operated.approvals, drive())
                waiting(operated.approvals, drive(0.3))
                command = [sys.executable, "-m", "ros2_mcp", "operate", "--state", str(folder.path)]
                size = {"LINES": "40", "COLUMNS": "100"}
                process = await asyncio.create_subprocess_exec(
                    *command, stdin=terminal, stdout=terminal, stderr=subprocess.STDOUT, env={**os.environ, **size}
                )
                await asyncio.to_thread(read_until, screen, "2 waiting")
                os.write(screen, b"j")
                await asyncio.to_thread(read_until, screen, f"▶ {first}")
                await asyncio.sleep(1.0)  # a request is read before it is answered: 0.7 s
                os.write(screen, b"a")
                await asyncio.to_thread(read_until, screen, f"{first} is approved")
                await asyncio.sleep(1.0)  # as long as a person takes who presses once more
                os.write(screen, b"a")
                await asyncio.to_thread(read_until, screen, "Nothing is chosen")
                assert len(operated.approvals.waiting()) == 1
            await asyncio.to_thread(read_until, screen, "The server has ended")
            assert await process.wait() == 1
        finally:
            os.close(screen)
            os.close(terminal)

    run(work)


def read_until(screen: int, text: str) -> None:
    """Reads what a terminal shows until that is there. Fails after 60 s: processes start slowly on a loaded machine."""
    shown_so_far, deadline = "", time.monotonic() + 60.0
    while text not in shown_so_far:
        ready, _, _ = select.select([screen], [], [], max(0.0, deadline - time.monotonic()))
        assert ready, f"{text!r} was not shown: {shown_so_far[-3000:]}"
        shown_so_far += os.read(screen, 65_536).decode(errors="replace")


def test_the_server_of_a_robot_with_a_name_is_found_without_its_policy(tmp_path: Path) -> None:
    async def work() -> None:
        usual = StateFolder(tmp_path / "domain-7@here")
        async with served(tmp_path, usual) as (operated, folder):
            request_id = waiting(operated.approvals, drive())
            assert (await printed("operate", "--state", str(usual.path), "approve", request_id))[0] == 0
            assert await asyncio.to_thread(folder_of, usual.path) == folder.path
            async with served(tmp_path, usual, "another") as (_, another):
                with pytest.raises(BadInput, match="several robots") as several:
                    await asyncio.to_thread(servers_in, usual.path)
                assert str(folder.path) in str(several.value)
                assert str(another.path) in str(several.value)
                for one in (folder, another):  # has taken in what connected before
                    assert (await asked(one))[0] == 0
        assert list(usual.path.iterdir()) == []
        (usual.path / "operate-gone.sock").symlink_to(folder.path / "operate-gone.sock")  # its server was killed
        assert folder_of(usual.path) == usual.path

    run(work)


def test_without_a_server_a_reset_works_on_the_latch_and_is_in_the_audit(tmp_path: Path) -> None:
    folder = StateFolder(tmp_path / "hall-3")
    folder.latch().set(by="watchdog", reason="it moves")
    run(lambda: check_reset(folder))
    [entry] = entries(folder.path / "audit")
    assert (entry["kind"], entry["was"], entry["count"]) == ("reset", "it moves", 1)
    assert verify(folder.path / "audit").faults == []


async def check_reset(folder: StateFolder) -> None:
    code, text = await asked(folder)
    assert code == 1
    assert "No server of the robot hall-3 is running" in text
    assert "operate reset" in text
    code, text = await asked(folder, "reset")
    assert code == 0
    assert "hall-3: The latch is reset" in text
    assert "It was set by watchdog: it moves." in text
    assert not folder.latch().look().is_set
    assert "The latch of hall-3 is not set." in (await asked(folder, "reset"))[1]


def test_times_and_bounds_are_read_as_they_are_written() -> None:
    assert granted(["10m", "linear=0.2"]) == {"for_s": 600.0, "most": {"linear": 0.2}}
    assert granted(["90s"]) == {"for_s": 90.0, "most": {}}
    for bad in ([], ["linear=0.2"], ["soon"], ["60", "linear=fast"]):
        with pytest.raises(BadInput):
            granted(bad)


def test_the_audit_is_shown_and_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    async def work() -> None:
        log = Audit(lambda: tmp_path)
        log.after(await log.before(drive().line(decision="allowed", rate_hz=10.0, duration_s=2.0)), "done")
        log.close()

    run(work)
    assert audit_command(tmp_path, "show") == 0
    head, first, second = capsys.readouterr().out.splitlines()
    assert head == f"The audit of {tmp_path.parent.name}, in {tmp_path}"
    assert "act local verb=publish name=/cmd_vel rate_hz=10.0 duration_s=2.0" in first
    assert "outcome of=1 outcome=done" in second
    assert audit_command(tmp_path, "verify") == 0
    [path] = tmp_path.glob("*.jsonl")
    path.write_bytes(path.read_bytes().replace(b"/cmd_vel", b"/cmd_veI"))
    capsys.readouterr()
    assert audit_command(tmp_path, "verify") == 1
    assert "CHANGED: audit-000000000001.jsonl line 1" in capsys.readouterr().out
    with pytest.raises(NotFound):
        audit_command(tmp_path / "nothing", "show")


def test_a_step_that_does_not_exist_is_told(tmp_path: Path) -> None:
    async def work() -> None:
        async with served(tmp_path) as (_, folder):
            with pytest.raises(BadInput, match="approve"):
                await asyncio.to_thread(operate, folder.path, "aprove", ["A7K2"])
            [server] = await asyncio.to_thread(servers_in, folder.path)
            await asyncio.to_thread(server.do, "list")
            server.close()

    run(work)
