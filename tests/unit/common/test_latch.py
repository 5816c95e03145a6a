"""The latch: one file that server, bridge and stopper write and read."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from ros2_mcp_common import latch as latch_module
from ros2_mcp_common.latch import FILE, Latch, LatchState, ResetRefused
from support.processes import python_path

PATIENCE_S = 60.0


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "robot" / "latch.json"


def test_what_one_sets_all_see_and_those_who_come_later(path: Path) -> None:
    first, second = Latch(path), Latch(path)
    assert not first.look().is_set and not second.look().is_set
    before_s = time.time()
    assert first.set(by="ros2_stop", reason="the agent asked") == ""
    after_s = time.time()
    for latch in (first, second, Latch(path)):
        state = latch.look()
        assert state.is_set and (state.by, state.reason) == ("ros2_stop", "the agent asked")
        assert before_s <= state.since <= after_s


def test_only_a_reset_resets_it_and_says_who_did(path: Path) -> None:
    server, operator = Latch(path), Latch(path)
    server.set(by="watchdog", reason="too fast")
    operator.reset(by="operator ann", seen=operator.look().count)
    assert not server.look().is_set and server.look().by == "operator ann"
    assert not Latch(path).look().is_set


def test_the_first_cause_stays_and_the_count_tells_of_the_next(path: Path) -> None:
    first, second = Latch(path), Latch(path)
    first.set(by="one", reason="a")
    before = second.look()
    second.set(by="two", reason="b")
    after = first.look()
    assert (after.by, after.reason, after.since) == ("one", "a", before.since) and after.count == before.count + 1


def test_who_resets_what_he_has_not_seen_is_refused(path: Path) -> None:
    latch = Latch(path)
    latch.set(by="one", reason="a")
    seen = latch.look().count
    Latch(path).set(by="two", reason="b")
    with pytest.raises(ResetRefused):
        latch.reset(by="operator", seen=seen)
    assert latch.look().is_set


def test_the_count_never_falls_so_that_what_was_accepted_before_stays_stopped(path: Path) -> None:
    latch, counts = Latch(path), [0]
    for _ in range(20):
        Latch(path).set(by="a", reason="b")
        counts.append(latch.look().count)
        latch.reset(by="c", seen=counts[-1])
        assert latch.look().count == counts[-1]
    assert counts == sorted(set(counts))


ODD = '{"is_set": false, "count": 1, "by": 5, "reason": "", "since": 0.0}'


@pytest.mark.parametrize(
    "text", ["", "{", "null", "[]", "3", '{"is_set": 0}', '{"is_set": false}x', '{"other": 1}', '{"count": "9"}', ODD]
)
def test_what_cannot_be_read_counts_as_set(path: Path, text: str) -> None:
    path.parent.mkdir()
    path.write_text(text)
    latch = Latch(path)
    assert latch.look().is_set and "cannot be read" in latch.look().reason
    latch.reset(by="operator", seen=latch.look().count)
    assert not Latch(path).look().is_set


def test_a_file_that_vanishes_changes_nothing_for_whoever_has_seen_it(path: Path) -> None:
    latch = Latch(path)
    latch.set(by="a", reason="b")
    path.unlink()
    assert latch.look().is_set


@pytest.mark.promise("stopping", "as on a full disk, holds in the process that set it")
def test_it_holds_in_this_process_also_where_it_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    latch = Latch(tmp_path / "file" / "latch.json")
    assert "latch.json" in latch.set(by="a", reason="b") or latch.look().is_set
    assert latch.look().is_set


@pytest.mark.promise("stopping", "that of the watchdog is tried again every 2 s")
def test_what_could_not_be_written_is_written_as_soon_as_it_can_be_and_then_resets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert latch_module.WRITTEN_AGAIN_S == 2.0
    monkeypatch.setattr(latch_module, "WRITTEN_AGAIN_S", 0.01)
    path = tmp_path / "robot" / "latch.json"
    path.parent.write_text("in the way")
    bridges, servers = Latch(path), Latch(path)
    bridges.hold(by="watchdog", reason="it moves")
    writing = threading.Thread(target=bridges.write_at_last)
    writing.start()
    assert writing.is_alive() and bridges.look().is_set
    path.parent.unlink()
    writing.join(10)
    assert not writing.is_alive() and servers.look().is_set
    servers.reset(by="operator ann", seen=servers.look().count)
    assert not bridges.look().is_set


def test_without_a_path_it_is_kept_in_memory() -> None:
    latch = Latch()
    assert latch.look() == LatchState()
    latch.set(by="a", reason="b")
    assert latch.look().is_set
    latch.reset(by="operator", seen=1)
    assert not latch.look().is_set


def test_the_file_is_for_its_owner_alone_and_no_link_is_followed(path: Path, tmp_path: Path) -> None:
    Latch(path).set(by="a", reason="b")
    assert path.stat().st_mode & 0o777 == 0o600 and path.parent.stat().st_mode & 0o777 == 0o700
    target = tmp_path / "target"
    target.write_text("kept")
    path.unlink()
    path.symlink_to(target)
    Latch(path).set(by="a", reason="b")
    assert target.read_text() == "kept" and Latch(path).look().is_set


def test_one_that_hangs_in_its_turn_does_not_keep_a_stop_from_being_latched(path: Path) -> None:
    Latch(path).set(by="a", reason="b")
    Latch(path).reset(by="operator", seen=1)
    holds = f"import fcntl, sys; f = open({str(path.with_suffix('.lock'))!r}); fcntl.flock(f, fcntl.LOCK_EX); "
    with subprocess.Popen(
        [sys.executable, "-c", holds + "print(flush=True); sys.stdin.read()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as holder:
        assert holder.stdout and holder.stdout.readline()
        latch = Latch(path)
        with pytest.raises(ResetRefused):
            latch.reset(by="operator", seen=1)
        assert latch.set(by="stopper", reason="the bridge died") == ""
        assert Latch(path).look().is_set
        holder.kill()


def test_settings_and_resets_at_once_lose_no_setting(path: Path) -> None:
    """Four processes set it 40 times each; all are counted, and one that resets meanwhile resets only what it saw.

    Each waits for its turn for as long as it takes: what happens without one, the tests below say.
    """
    script = (
        "import sys; from pathlib import Path; from ros2_mcp_common import latch as module\n"
        f"module.TURN_S = {PATIENCE_S}; latch = module.Latch(Path({str(path)!r})); sys.stdin.read()\n"
        "for number in range(40): latch.set(by='x', reason=str(number))\n"
    )
    environment = {**os.environ, "PYTHONPATH": python_path()}
    setters = [
        subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, env=environment) for _ in range(4)
    ]
    for setter in setters:
        assert setter.stdin
        setter.stdin.close()
    operator = Latch(path)
    while any(setter.poll() is None for setter in setters):
        with contextlib.suppress(ResetRefused):
            operator.reset(by="operator", seen=operator.look().count)
        time.sleep(0.005)  # or nobody else had a turn
    assert all(setter.returncode == 0 for setter in setters)
    assert Latch(path).look().count == 160


def test_who_sets_it_without_a_turn_takes_no_number_of_another(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or an operator who has looked at the one would reset the other with it."""
    monkeypatch.setattr(latch_module, "TURN_S", 0.01)
    Latch(path).set(by="a", reason="first")
    before, first, second = path.read_bytes(), Latch(path), Latch(path)
    with path.with_suffix(".lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        first.set(by="b", reason="b")
        seen = first.look().count
        path.write_bytes(before)  # the other one read it before that was written
        second.set(by="c", reason="c")
    with pytest.raises(ResetRefused):
        Latch(path).reset(by="operator", seen=seen)


def test_a_look_costs_microseconds_and_is_safe_from_threads(path: Path) -> None:
    latch, other, ended = Latch(path), Latch(path), threading.Event()
    wrong: list[object] = []

    def look() -> None:
        last = 0
        while not ended.is_set():
            state = latch.look()
            if state.count < last:
                wrong.append(state)
            last = state.count

    threads = [threading.Thread(target=look) for _ in range(3)]
    for thread in threads:
        thread.start()
    for _ in range(50):
        other.set(by="a", reason="b")
    ended.set()
    for thread in threads:
        thread.join()
    assert not wrong and latch.look().count == 50 and json.loads(path.read_text())["count"] == 50


def told(count: int, by: str = "") -> LatchState:
    """How the latch is on the other machine: set where somebody has set it."""
    return LatchState(is_set=bool(by), count=count, by=by)


def test_a_mirror_is_set_and_reset_as_the_latch_elsewhere_is() -> None:
    mirror = Latch()
    for state, is_set, count in (
        (told(7), False, 0),  # reset long before
        (told(7), False, 0),
        (told(8, "operator"), True, 1),
        (told(9, "operator"), True, 2),
        (told(9), False, 2),
        (told(10), False, 3),  # set and reset between two looks: what was accepted before does not act
    ):
        mirror.mirror(state)
        assert (mirror.look().is_set, mirror.look().count) == (is_set, count)


def test_what_a_mirror_sets_itself_is_not_reset_before_it_was_set_elsewhere() -> None:
    mirror = Latch()
    mirror.mirror(told(3))
    mirror.set(by="watchdog", reason="too fast")
    mirror.mirror(told(3))  # has not heard of it yet
    mirror.mirror(told(4))
    assert mirror.look().by == "watchdog"
    mirror.mirror(told(5, "watchdog"))
    mirror.mirror(told(5))
    assert not mirror.look().is_set


def test_a_latch_with_a_file_mirrors_nothing(tmp_path: Path) -> None:
    latch = Latch(tmp_path / FILE)
    latch.mirror(told(1, "somebody"))
    assert not latch.look().is_set
