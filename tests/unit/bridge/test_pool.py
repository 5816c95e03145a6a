"""The pool keeps what may be needed again, within bounds, and never takes away what is in use."""

from __future__ import annotations

import time

import pytest

from ros2_mcp_bridge.topics.pool import Pool


def test_the_same_key_gives_the_same_entity_and_says_whether_it_is_new() -> None:
    pool: Pool[str, list[int]] = Pool(lambda _: None)
    with pool.use("a", lambda: [1]) as (first, is_new):
        assert is_new
    with pool.use("a", lambda: [2]) as (again, is_new):
        assert again is first
        assert not is_new


def test_the_least_recently_used_gives_way() -> None:
    destroyed: list[str] = []
    pool = Pool[str, str](destroyed.append, limit=2)
    for key in ("a", "b", "a", "c"):
        with pool.use(key, lambda key=key: key):
            pass
    assert destroyed == ["b"]
    assert set(pool.entities()) == {"a", "c"}


def test_what_is_in_use_is_kept_beyond_the_limit() -> None:
    destroyed: list[str] = []
    pool = Pool[str, str](destroyed.append, limit=1)
    with pool.use("a", lambda: "a"), pool.use("b", lambda: "b"):
        assert len(pool) == 2
    with pool.use("c", lambda: "c"):
        assert destroyed == ["b", "a"]


def test_only_what_has_been_idle_for_long_expires() -> None:
    destroyed: list[str] = []
    pool = Pool[str, str](destroyed.append, idle_s=0.5)  # longer than a busy machine keeps this test waiting
    with pool.use("used", lambda: "used"):
        with pool.use("idle", lambda: "idle"):
            pass
        pool.expire()
        assert destroyed == []
        time.sleep(0.6)
        pool.expire()
        assert destroyed == ["idle"]


def test_an_entity_that_cannot_be_made_leaves_nothing_behind() -> None:
    pool: Pool[str, int] = Pool(lambda _: None)
    with pytest.raises(ZeroDivisionError), pool.use("a", lambda: 1 // 0):
        pass
    assert len(pool) == 0


def test_clearing_destroys_all() -> None:
    destroyed: list[str] = []
    pool = Pool[str, str](destroyed.append)
    with pool.use("a", lambda: "a"):
        pool.clear()
        assert destroyed == ["a"]
    assert len(pool) == 0


def test_what_is_still_needed_is_kept_however_long_nobody_used_it() -> None:
    destroyed, needed = list[str](), {"driven"}
    pool = Pool[str, str](destroyed.append, limit=1, idle_s=0.0, keeps=needed.__contains__)
    for key in ("driven", "other", "third"):
        with pool.use(key, lambda key=key: key):
            pass
    time.sleep(0.01)
    pool.expire()
    assert destroyed == ["other", "third"]
    needed.clear()
    pool.expire()
    assert destroyed == ["other", "third", "driven"]
