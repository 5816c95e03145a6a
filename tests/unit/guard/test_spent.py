"""What was used of a policy's budgets outlives bridge and server, in one small file."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from ros2_mcp.guard import spent
from ros2_mcp.guard.spent import Spent, told
from ros2_mcp.guard.state import StateFolder
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.request import OperationError
from ros2_mcp_common.policy.ramp import Bucket, PerMinute
from support.agent import until

USED = ("/dock", "std_srvs/srv/Trigger", "per_minute")


@pytest.fixture
def folder(tmp_path: Path) -> StateFolder:
    return StateFolder(tmp_path / "robot")


def written(folder: StateFolder, number: int) -> bool:
    try:
        return sum(len(each[3]) for each in json.loads((folder.path / "spent.json").read_text())) == number
    except (FileNotFoundError, ValueError, IndexError, TypeError):  # not yet, or what was there before
        return False


def test_the_next_server_knows_what_was_used_and_for_how_long_it_is_past(folder: StateFolder) -> None:
    now = time.time()
    first = Spent(folder, lambda: now)
    first.add(*USED)
    now += 20.0
    first.add(*USED)
    until(lambda: written(folder, 2))
    now += 10.0
    assert Spent(folder, lambda: now).ages() == [(*USED, [30.0, 10.0])]
    now += 1000.0
    assert Spent(folder, lambda: now).ages() == []


def test_of_a_slow_rate_only_the_last_use_is_kept(folder: StateFolder) -> None:
    kept = Spent(folder)
    for _ in range(3):
        kept.add("/lamp", "std_msgs/msg/Bool", "rate_hz")
    assert [len(ages) for *_, ages in kept.ages()] == [1]


def test_what_is_kept_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spent, "_MOST_TIMES", 3)
    monkeypatch.setattr(spent, "_MOST_KEYS", 2)
    kept = Spent()
    for name in ("/a", "/b", "/c"):
        for _ in range(5):
            kept.add(name, "std_srvs/srv/Trigger", "per_minute")
    assert [(name, len(ages)) for name, _, _, ages in kept.ages()] == [("/b", 3), ("/c", 3)]


@pytest.mark.parametrize("text", ["", "{", "[[1]]", '[["a", "b", "c", ["x"]]]', "7"])
def test_a_file_that_cannot_be_read_is_replaced(folder: StateFolder, text: str) -> None:
    (folder.make() / "spent.json").write_text(text)
    kept = Spent(folder)
    assert kept.ages() == []
    kept.add(*USED)
    until(lambda: written(folder, 1))


def test_a_clock_that_was_set_back_gives_no_budget_back(folder: StateFolder) -> None:
    now = time.time()
    first = Spent(folder, lambda: now)
    first.add(*USED)
    until(lambda: written(folder, 1))
    assert Spent(folder, lambda: now - 3600.0).ages() == [(*USED, [0.0])]


def test_a_bridge_goes_on_where_the_one_before_it_was_ended() -> None:
    used = Spent()
    used.add(*USED)
    limiter = Limiter(True, now=lambda: 1000.0)
    limiter.take(told({"digest": "d", "policies": []}, used))
    limiter.check_minute(USED[:2], 2)
    with pytest.raises(OperationError, match="may be used 2 times a minute, and this limit is reached"):
        limiter.check_minute(USED[:2], 2)


def test_what_another_server_used_meanwhile_is_added_to_what_is_known(folder: StateFolder) -> None:
    now = time.time()
    waits, acts = Spent(folder, lambda: now), Spent(folder, lambda: now)
    acts.add(*USED)
    until(lambda: written(folder, 1))
    waits.read()
    waits.read()
    assert waits.ages() == [(*USED, [0.0])]


def test_a_bridge_that_runs_takes_over_what_another_one_has_used() -> None:
    limiter = Limiter(True, now=lambda: 1000.0)
    limiter.take(told({"digest": "d", "policies": []}, Spent()))
    limiter.resume(json.dumps([(*USED, [50.0, 10.0])]).encode())
    with pytest.raises(OperationError, match="may be used 2 times a minute"):
        limiter.check_minute(USED[:2], 2)
    with pytest.raises(OperationError, match="cannot be read"):
        limiter.resume(b"7")


def test_what_was_used_is_over_after_its_time() -> None:
    assert PerMinute([930.0, 950.0]).take(1000.0, 2)
    assert not PerMinute([945.0, 950.0]).take(1000.0, 2)
    assert not Bucket(0.1, 995.0).take(1000.0)
    assert Bucket(0.1, 985.0).take(1000.0)
    assert Bucket(0.1).take(1000.0)
