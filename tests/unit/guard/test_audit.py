"""The audit: every change of what was written is found, and what cannot be written is not done."""

from __future__ import annotations

import asyncio
import hashlib
import json
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import cast

import pytest

from ros2_mcp.guard import audit as audit_module
from ros2_mcp.guard import chain
from ros2_mcp.guard.audit import Audit, called_through
from ros2_mcp.guard.audit_file import AuditFile
from ros2_mcp.guard.chain import Head, verify
from ros2_mcp.guard.consent import Auditing
from ros2_mcp.guard.guard import Guard
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import Refused
from ros2_mcp.ops.audit.read import read
from ros2_mcp.robot import Robot
from support.rounds import FULL

LINES, CHANGES = (100_000, 1000) if FULL else (600, 60)


def written(folder: Path, lines: int, file_bytes: int = 0) -> AuditFile:
    folder.mkdir(exist_ok=True)
    file = AuditFile(folder, file_bytes=file_bytes or lines * 40)
    for number in range(lines):
        file.append({"kind": "act", "name": f"/topic_{number % 7}", "value": number})
    return file


def test_what_was_written_is_whole_also_over_files_and_restarts(tmp_path: Path) -> None:
    verdict = verify(tmp_path)
    for start in range(3):
        file = written(tmp_path, 50, file_bytes=4000)
        file.close()
        verdict = verify(tmp_path)
        assert verdict.faults == [] == verdict.notes
        assert verdict.head.seq == file.head.seq >= 50 * (start + 1)
    assert verdict.files > 3
    values = [entry["value"] for entry in chain.entries(tmp_path) if entry["kind"] == "act"]
    assert values == [*range(50)] * 3


def test_the_end_of_the_chain_is_known_before_the_first_line_of_a_server(tmp_path: Path) -> None:
    audit = Audit(lambda: tmp_path, path=tmp_path)
    assert audit.head == Head()
    written(tmp_path, 5).close()
    assert audit.head.short == verify(tmp_path).head.short != Head().short


def test_what_is_refused_names_the_tool_through_which_it_was_asked(tmp_path: Path) -> None:
    audit = Audit(lambda: tmp_path)
    with called_through("ros2_service_call"):
        audit.note("refused", name="/horn")
    audit.close()
    assert [entry["tool"] for entry in chain.entries(tmp_path) if entry["kind"] == "refused"] == ["ros2_service_call"]


def test_files_are_for_their_owner_alone_and_opened_to_append(tmp_path: Path) -> None:
    written(tmp_path, 3)
    assert {oct(path.stat().st_mode & 0o777) for path in tmp_path.iterdir()} == {"0o600"}


Change = Callable[[list[bytes], int, random.Random], None]


def flip(lines: list[bytes], at: int, chance: random.Random) -> None:
    place = chance.randrange(len(lines[at]) - 1)
    lines[at] = lines[at][:place] + bytes([lines[at][place] ^ chance.choice((1, 2, 4, 8))]) + lines[at][place + 1 :]


def change_value(lines: list[bytes], at: int, _: random.Random) -> None:
    lines[at] = lines[at].replace(b'"value":', b'"value":1', 1)


def cut(lines: list[bytes], at: int, chance: random.Random) -> None:
    del lines[at : at + chance.randint(1, 3)]


def swap(lines: list[bytes], at: int, chance: random.Random) -> None:
    other = (at + chance.randint(1, len(lines) - 1)) % len(lines)
    lines[at], lines[other] = lines[other], lines[at]


def double(lines: list[bytes], at: int, _: random.Random) -> None:
    lines.insert(at, lines[at])


def truncate(lines: list[bytes], at: int, chance: random.Random) -> None:
    del lines[-(1 + at % min(9, len(lines))) :]
    if lines and chance.random() < 0.5:
        lines[-1] = lines[-1][: chance.randint(1, len(lines[-1]) - 1)]


def forge(lines: list[bytes], at: int, _: random.Random) -> None:
    """A line with a right hash of its own, made by somebody who has read how."""
    entry = json.loads(lines[at])
    lines[at] = chain.line_of(entry["seq"], entry["prev"], {"kind": "act", "name": "/innocent"})[0]


CHANGE: list[Change] = [
    flip,
    change_value,
    cut,
    swap,
    double,
    truncate,
    forge,
]


@pytest.mark.timeout(1800)
def test_every_edit_cut_swap_and_truncation_is_found(tmp_path: Path) -> None:
    """Bar 15."""
    written(tmp_path, LINES, file_bytes=LINES * 60).close()
    files = chain.files_of(tmp_path)
    assert len(files) > 2
    assert verify(tmp_path).faults == []
    chance = random.Random(15)
    unseen: list[str] = []
    for number in range(CHANGES):
        change, path = CHANGE[number % len(CHANGE)], chance.choice(files)
        original = path.read_bytes()
        lines = original.splitlines(keepends=True)
        at = chance.randrange(len(lines))
        change(lines, at, chance)
        changed = b"".join(lines)
        if changed == original:
            continue
        path.write_bytes(changed)
        if not verify(tmp_path, most=1).faults:
            unseen.append(f"{change.__name__} of line {at} of {path.name}")
        path.write_bytes(original)
    assert unseen == []
    assert verify(tmp_path).faults == []


def test_a_missing_file_is_found_whichever_it_is(tmp_path: Path) -> None:
    written(tmp_path, 300, file_bytes=5000).close()
    for path in [*chain.files_of(tmp_path), tmp_path / chain.HEAD]:
        away = path.rename(tmp_path / "away")
        assert verify(tmp_path).faults, path.name
        away.rename(path)


def test_a_copied_head_shows_that_the_whole_audit_was_made_anew(tmp_path: Path) -> None:
    head = written(tmp_path / "a", 20).head.short
    assert verify(tmp_path / "a", copied=head).faults == []
    written(tmp_path / "b", 25)  # other values from the first line on
    (tmp_path / "b" / chain.HEAD).unlink()
    for path in (tmp_path / "b").iterdir():
        path.unlink()
    file = AuditFile(tmp_path / "b")
    for number in range(25):
        file.append({"kind": "act", "value": -number})
    assert verify(tmp_path / "b").faults == []
    assert verify(tmp_path / "b", copied=head).faults


def test_what_was_cut_while_no_server_ran_stays_told_after_the_next_start(tmp_path: Path) -> None:
    written(tmp_path, 30, file_bytes=10**6).close()
    path = chain.files_of(tmp_path)[0]
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-4]))
    written(tmp_path, 5).close()
    assert any("26" in fault for fault in verify(tmp_path).faults)
    (tmp_path / chain.HEAD).unlink()
    written(tmp_path, 5).close()
    assert any("head was missing" in fault for fault in verify(tmp_path).faults)


def test_the_oldest_files_give_way_and_that_is_no_fault_but_one_more_is(tmp_path: Path) -> None:
    file = AuditFile(tmp_path, file_bytes=3000, keep_bytes=10_000)
    for number in range(400):
        file.append({"kind": "act", "value": number})
    files = chain.files_of(tmp_path)
    assert files[0].name > chain.file_name(1)
    assert sum(path.stat().st_size for path in files) < 15_000
    assert verify(tmp_path).faults == []
    files[0].unlink()
    assert verify(tmp_path).faults


def test_two_servers_write_one_chain(tmp_path: Path) -> None:
    both = AuditFile(tmp_path, file_bytes=2000), AuditFile(tmp_path, file_bytes=2000)
    for number in range(100):
        both[number % 3 % 2].append({"kind": "act", "value": number})
    verdict = verify(tmp_path)
    assert verdict.faults == []
    assert [entry["value"] for entry in chain.entries(tmp_path) if entry["kind"] == "act"] == [*range(100)]


def test_a_kill_loses_no_line_of_an_act_that_was_carried_out(tmp_path: Path) -> None:
    """Bar 15: what the writer said it had written is there after `kill -9`, and the next server goes on."""
    program = (
        "import sys; from pathlib import Path; from ros2_mcp.guard.audit_file import AuditFile\n"
        f"file = AuditFile(Path({str(tmp_path)!r}), file_bytes=5000)\n"
        "for number in range(10**9):\n"
        "    print(file.append({'kind': 'act', 'value': number}).seq, flush=True)\n"
    )
    chance = random.Random(15)
    for _ in range(50 if FULL else 3):
        with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout
            last = 0
            for _ in range(chance.randint(1, 400)):
                last = int(writer.stdout.readline())
            writer.send_signal(signal.SIGKILL)
            rest = writer.stdout.read().split()
        said = int(rest[-1]) if rest else last
        verdict = verify(tmp_path)
        assert verdict.faults == []
        assert verdict.head.seq >= said


def test_half_a_line_that_a_kill_left_is_cut_off_and_a_whole_one_is_kept(tmp_path: Path) -> None:
    file = written(tmp_path, 5, file_bytes=10**6)
    path = chain.files_of(tmp_path)[0]
    whole, _ = chain.line_of(file.head.seq + 1, file.head.hash, {"kind": "act", "value": "whole"})
    path.write_bytes(path.read_bytes() + whole + b'{"seq":7,"prev":"half')
    verdict = verify(tmp_path)
    assert verdict.faults == []
    assert len(verdict.notes) == 2
    written(tmp_path, 1, file_bytes=10**6)
    assert verify(tmp_path).faults == [] == verify(tmp_path).notes
    assert verify(tmp_path).head.seq == 7


@pytest.fixture
def small_disk(tmp_path: Path):
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("a small disk can be mounted by root only")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_refuses_acts_under_a_policy_and_never_leaves_half_a_line(small_disk: Path) -> None:
    """Bar 15."""

    async def fill() -> tuple[int, int]:
        audit = Audit(lambda: small_disk, required=True)
        done = 0
        with pytest.raises(Refused, match="audit cannot be written"):
            for number in range(100_000):
                before = await audit.before({"name": "/cmd_vel", "value": "x" * 200})
                done += 1
                audit.after(before, "done", detail=str(number))
        refused = 0
        for _ in range(20):
            try:
                await audit.before({"name": "/cmd_vel"})
            except Refused:
                refused += 1
        audit.note("stop", by="local")  # what stops is not held up by it
        audit.close()
        return done, refused

    done, refused = asyncio.run(fill())
    assert done > 10
    assert refused == 20
    assert verify(small_disk).faults == []
    kinds = [entry["kind"] for entry in chain.entries(small_disk)]
    assert kinds.count("act") == done == kinds.count("outcome")  # there was room left for what became of each
    (small_disk / "rest").write_bytes(b"")
    with pytest.raises(OSError, match="No space"):
        for block in range(10_000_000, 100, -100):
            with (small_disk / "rest").open("ab") as rest:
                rest.write(b"x" * min(block, 4096))
    file = AuditFile(small_disk)
    with pytest.raises(OSError, match="No space"):
        for number in range(1000):
            file.append({"kind": "act", "value": number})
    assert verify(small_disk).faults == []
    assert verify(small_disk).notes == []


def test_without_a_policy_a_folder_that_cannot_be_written_refuses_nothing(tmp_path: Path) -> None:
    async def act() -> str:
        audit = Audit(lambda: tmp_path / "not there")
        audit.after(await audit.before({"name": "/cmd_vel"}), "done")
        audit.close()
        return audit.failed

    assert asyncio.run(act()) == "No such file or directory"


@pytest.mark.parametrize("policy", ["", "abc"])
def test_only_under_a_policy_an_act_waits_for_its_line(tmp_path: Path, policy: str) -> None:
    async def act() -> bool:
        disk = threading.Event()

        def folder() -> Path:
            disk.wait()
            return tmp_path

        audit = Audit(folder, policy=policy)
        acting = asyncio.ensure_future(audit.before({"name": "/cmd_vel"}))
        for _ in range(10):
            await asyncio.sleep(0)
        waits = not acting.done()
        disk.set()
        audit.after(await acting, "done")
        audit.close()
        return waits

    assert asyncio.run(act()) == bool(policy)
    act_line, outcome = chain.entries(tmp_path)
    assert outcome["of"] == act_line["seq"]


def test_a_disk_that_hangs_without_a_policy_does_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ros2_mcp.guard.audit.MOST_QUEUED", most := 100)

    async def act() -> None:
        disk = threading.Event()

        def folder() -> Path:
            disk.wait()
            return tmp_path

        audit = Audit(folder)
        for _ in range(most + 10):
            await audit.before({"name": "/cmd_vel"})
        disk.set()
        await audit.written()
        audit.note("stop")
        audit.close()

    asyncio.run(act())
    *_, stop = lines = list(chain.entries(tmp_path))
    assert most < len(lines) <= most + 3
    assert sum(line.get("unwritten_before", 0) for line in lines) == most + 11 - len(lines)
    assert stop["kind"] == "stop"


def test_a_server_that_hangs_with_the_head_locked_holds_nobody_up_for_long(tmp_path: Path) -> None:
    import fcntl
    from time import monotonic

    written(tmp_path, 1)
    with (tmp_path / chain.HEAD).open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        began = monotonic()
        with pytest.raises(OSError, match="another server"):
            AuditFile(tmp_path).append({"kind": "act"})
        if FULL:
            assert monotonic() - began < 1.0


def test_under_a_policy_the_head_is_copied_to_the_log_and_tells_that_lines_were_cut(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit_module, "COPIED_EVERY_S", 0.0)

    def noted(folder: Path, policy: str) -> list[str]:
        caplog.clear()
        folder.mkdir()
        audit = Audit(lambda: folder, policy=policy)
        for number in range(3):
            audit.note("stop", by=str(number))
        audit.close()
        return [record.getMessage().rpartition(" ")[2] for record in caplog.records]

    assert noted(tmp_path / "without", "") == []
    folder = tmp_path / "under"
    copied = noted(folder, "abc")
    assert [head.partition(":")[0] for head in copied] == ["1", "2", "3"]
    assert not any(verify(folder, head).faults for head in copied)
    [file] = chain.files_of(folder)
    file.write_bytes(b"".join(file.read_bytes().splitlines(keepends=True)[:2]))
    (folder / chain.HEAD).unlink()
    AuditFile(folder).append({"kind": "stop"})
    assert any(copied[-1].partition(":")[2] in fault for fault in verify(folder, copied[-1]).faults)


def test_a_link_in_the_place_of_a_file_is_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_bytes(b"")
    folder = tmp_path / "audit"
    folder.mkdir()
    (folder / chain.file_name(1)).symlink_to(target)
    with pytest.raises(OSError, match="symbolic links"):
        AuditFile(folder).append({"kind": "act"})
    assert target.read_bytes() == b""


def test_lines_that_nobody_waits_for_are_written_together(tmp_path: Path) -> None:
    held: list[int] = []

    async def act() -> None:
        audit = Audit(lambda: tmp_path)
        for number in range(20):
            audit.after(await audit.before({"name": f"/t{number}"}), "done")
        await audit.written()
        audit.close()

    class Counted(AuditFile):
        def held(self) -> AbstractContextManager[None]:
            held.append(1)
            return super().held()

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("ros2_mcp.guard.audit.AuditFile", Counted)
        asyncio.run(act())
    assert (verify(tmp_path).head.seq, len(held) < 20) == (40, True)
    lines = list(chain.newest(tmp_path))
    assert [line["of"] for line in lines if line["kind"] == "outcome"] == [
        line["seq"] for line in lines if line["kind"] == "act"
    ]


def test_listeners_hear_of_every_entry_and_long_values_are_cut(tmp_path: Path) -> None:
    heard: list[object] = []

    async def act() -> None:
        audit = Audit(lambda: tmp_path, policy="abc")
        with audit.listened(lambda _, entry: heard.append(entry["kind"])):
            line = await audit.before({"name": "/text", "value": {"data": "x" * 5000}})
            audit.after(line, "done")
        audit.close()

    asyncio.run(act())
    assert heard == ["act", "outcome"]
    outcome, act_line = chain.newest(tmp_path)
    assert act_line["policy"] == "abc"
    assert len(json.dumps(act_line)) < 2000
    assert outcome["of"] == act_line["seq"] == 1
    assert verify(tmp_path).head == Head(2, outcome["hash"])


def test_lines_that_nobody_of_us_wrote_are_told_and_end_no_reading(tmp_path: Path) -> None:
    written(tmp_path, 3, file_bytes=100_000)
    [path] = chain.files_of(tmp_path)
    head = chain.read_head(tmp_path)
    assert head
    body = b'{"seq":4,"prev":"%s","kind":"rotation","dropped_to":"x"' % head.hash.encode()
    odd = body + b',"hash":"%s"}\n' % hashlib.sha256(body).hexdigest().encode()
    whole = path.read_bytes()
    for line in (odd, b"5\n", b"[" * 100_000 + b"\n", b'{"seq":%s}\n' % (b"9" * 5000)):
        path.write_bytes(whole + line)
        assert [entry["seq"] for entry in chain.entries(tmp_path)][:3] == [1, 2, 3]
        assert [entry["seq"] for entry in chain.newest(tmp_path)][-3:] == [3, 2, 1]
        verify(tmp_path)
    assert verify(tmp_path).faults
    (tmp_path / chain.HEAD).write_text('{"seq": 1e999, "hash": "", "file": "", "bytes": 0}')
    assert verify(tmp_path).faults


def test_a_client_reads_its_own_acts_however_many_others_have(tmp_path: Path) -> None:
    file = AuditFile(tmp_path)
    for number in range(50):
        principal = "mine" if number % 20 == 0 else "another"
        of = file.append({"kind": "act", "principal": principal, "name": f"/t{number}"}).seq
        file.append({"kind": "outcome", "of": of, "outcome": "done"})
    guard = Guard()
    guard.audit = Auditing(Audit(None, path=tmp_path), "", str)
    robot = Robot(cast(Bridge, None), guard)
    excerpt = asyncio.run(read(robot, robot.session(Principal(name="mine", transport="http")), 2))
    assert [(act.name, act.outcome) for act in excerpt.entries] == [("/t20", "done"), ("/t40", "done")]
