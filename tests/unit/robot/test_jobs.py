"""The registry of work: what has been begun can be found and stopped, whatever it is, and one failure ends one job."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import anyio
import pytest

from ros2_mcp.model.commands import LOCAL, Principal
from ros2_mcp.model.errors import BridgeLost, NotFound, Refused
from ros2_mcp.robot.jobs import Job, Jobs
from support.tasks import running_tasks, soon


class Watch(Job):
    """A kind of job that nothing else in the house knows of."""

    kind = "watch"
    most_running = 3
    most_kept = 5
    listed_by = "ros2_watch_list"
    stopped_by = "ros2_watch_stop"

    def __init__(self, *, owner: Principal = LOCAL, moves: tuple[str, ...] = (), begins: bool = True) -> None:
        super().__init__(owner=owner, moves=moves)
        self.begins = begins
        self.may_end = asyncio.Event()
        self.trouble: Exception | None = None
        self.is_clean = False

    async def run(self) -> None:
        try:
            if self.begins:
                self.begun()
            await self.may_end.wait()
            if self.trouble:
                raise self.trouble
        finally:
            with anyio.CancelScope(shield=True):
                await asyncio.sleep(0.01)
            self.is_clean = True


class Polite(Watch):
    """One that ends in good order, unless it is stubborn."""

    kind = "polite"
    patience_s = 0.1
    is_stubborn = False
    asked = 0

    async def wind_down(self) -> None:
        self.asked += 1
        if not self.is_stubborn:
            self.may_end.set()


class Other(Job):
    """As little as a kind of job can be."""

    kind = "other"

    async def run(self) -> None:
        self.begun()
        await asyncio.sleep(1000)


@asynccontextmanager
async def a_server() -> AsyncGenerator[Jobs]:
    """Its jobs, none of which may be left when it ends."""
    before, jobs = running_tasks(), Jobs()
    try:
        yield jobs
    finally:
        await jobs.close()
    assert running_tasks() == before
    assert not jobs.running(Job)


async def test_a_new_kind_of_job_is_a_class_and_nothing_else() -> None:
    async with a_server() as jobs:
        watch = Watch(moves=("/cmd_vel",))
        await jobs.start(watch)
        assert (watch.state, watch.is_running, watch.owner) == ("running", True, LOCAL)
        assert jobs.find(Watch, watch.id) is watch and jobs.running(Watch) == [watch]
        assert await jobs.stop_moving() == {watch: ""}
        assert (watch.state, watch.is_clean) == ("stopped", True)


async def test_ids_are_random_and_begin_with_their_kind() -> None:
    ids = {Watch().id for _ in range(100)}
    assert len(ids) == 100 and all(each.startswith("watch_") and len(each) == len("watch_") + 8 for each in ids)


async def test_an_unknown_id_is_answered_with_the_nearest_one() -> None:
    async with a_server() as jobs:
        with pytest.raises(NotFound, match=r"There is no watch 'none'. ros2_watch_list shows them."):
            jobs.find(Watch, "none")
        watch = Watch()
        await jobs.start(watch)
        with pytest.raises(NotFound, match=f"Did you mean {watch.id}?"):
            jobs.find(Watch, watch.id[:-1])
        with pytest.raises(NotFound, match="There is no polite"):
            jobs.find(Polite, watch.id)


async def test_a_job_that_ends_by_itself_has_ended() -> None:
    async with a_server() as jobs:
        watch = Watch()
        await jobs.start(watch)
        assert not await watch.wait(0.01) and watch.is_running
        watch.may_end.set()
        assert await watch.wait(20.0) and watch.state == "ended"
        await jobs.stop(Watch, watch.id)
        assert watch.state == "ended"


async def test_a_job_that_fails_ends_no_other() -> None:
    async with a_server() as jobs:
        bad, good = Watch(), Watch()
        for watch in (bad, good):
            await jobs.start(watch)
        bad.trouble = ZeroDivisionError("not foreseen")
        bad.may_end.set()
        await soon(lambda: bad.state == "failed")
        assert bad.failure is bad.trouble and good.is_running
        await jobs.start(Watch())


async def test_what_keeps_a_job_from_beginning_is_raised() -> None:
    async with a_server() as jobs:
        watch = Watch(begins=False)
        watch.trouble = BridgeLost("The bridge was lost.")
        watch.may_end.set()
        with pytest.raises(BridgeLost):
            await jobs.start(watch)
        assert watch.state == "failed" and watch.is_clean


async def test_the_error_of_a_task_group_is_the_error_itself() -> None:
    class Grouped(Watch):
        async def run(self) -> None:
            async with anyio.create_task_group() as outer, anyio.create_task_group() as inner:
                inner.start_soon(super().run)
                outer.start_soon(asyncio.sleep, 1000)

    async with a_server() as jobs:
        watch = Grouped(begins=False)
        watch.trouble = BridgeLost("The bridge was lost.")
        watch.may_end.set()
        with pytest.raises(BridgeLost):
            await jobs.start(watch)


async def test_a_job_can_be_stopped_while_it_is_beginning() -> None:
    async with a_server() as jobs:
        watch = Watch(begins=False)
        starting = asyncio.create_task(jobs.start(watch))
        await soon(lambda: bool(jobs.running(Watch)))
        await jobs.stop(Watch, watch.id)
        await starting
        assert watch.state == "stopped"


@pytest.mark.parametrize("natively", [True, False])
async def test_a_call_that_is_cancelled_ends_the_job_that_it_begins(natively: bool) -> None:
    async with a_server() as jobs:
        watch, scope = Watch(begins=False), anyio.CancelScope()

        async def call() -> None:
            with scope:
                await jobs.start(watch)

        calling = asyncio.create_task(call())
        await soon(lambda: bool(jobs.running(Watch)))
        (calling if natively else scope).cancel()
        await asyncio.wait({calling})
        assert (watch.state, watch.is_clean) == ("stopped", True)


async def test_a_beginning_that_takes_too_long_goes_on_by_itself() -> None:
    async with a_server() as jobs:
        watch = Watch(begins=False)
        await jobs.start(watch, within_s=0.01)
        assert watch.state == "starting"


async def test_a_call_may_await_its_job() -> None:
    async with a_server() as jobs:
        watch = Watch()
        asyncio.get_running_loop().call_later(0.02, watch.may_end.set)
        await jobs.run(watch)
        assert watch.state == "ended"
        awaited = Watch()
        with anyio.move_on_after(0.02):
            await jobs.run(awaited)
        assert awaited.state == "stopped"


async def test_a_call_that_is_cancelled_ends_what_it_awaits_at_once_and_not_after_its_patience() -> None:
    class Patient(Polite):
        patience_s = 3600.0
        is_stubborn = True

    async with a_server() as jobs:
        with anyio.move_on_after(0.02):
            await jobs.run(Patient())  # which would hang


async def test_a_job_ends_in_good_order_if_it_can_and_else_after_its_patience() -> None:
    async with a_server() as jobs:
        polite, stubborn = Polite(), Polite()
        stubborn.is_stubborn = True
        polite.patience_s = 3600.0  # this would hang if it did not end by itself
        for job in (polite, stubborn):
            await jobs.start(job)
        await jobs.stop(Polite, polite.id)
        async with anyio.create_task_group() as group:  # two who stop it at the same time ask once
            group.start_soon(stubborn.stop)
            group.start_soon(stubborn.stop)
        assert {polite.state, stubborn.state} == {"stopped"} and (polite.asked, stubborn.asked) == (1, 1)


async def test_what_keeps_one_from_a_good_end_keeps_no_other_from_ending() -> None:
    class Cut(Polite):
        async def wind_down(self) -> None:
            raise BridgeLost("The bridge was lost.")

    async with a_server() as jobs:
        cut, watch = Cut(moves=("/a",)), Watch(moves=("/b",))
        for job in (cut, watch):
            await jobs.start(job)
        ended = await jobs.stop_moving()
        assert list(ended) == [cut, watch] and ended[cut] and not ended[watch]  # why it did not end well is told
        assert {cut.state, watch.state} == {"stopped"}
        again = Cut()
        await jobs.start(again)
        with pytest.raises(BridgeLost):
            await jobs.stop(Cut, again.id)
        assert again.state == "stopped"


async def test_only_what_moves_is_stopped_with_the_robot() -> None:
    async with a_server() as jobs:
        recording, relay = Watch(), Watch(moves=("/cmd_vel",))
        for job in (recording, relay):
            await jobs.start(job)
        await jobs.stop_moving()
        assert (recording.state, relay.state) == ("running", "stopped")


async def test_the_end_of_a_client_ends_what_it_left_in_motion() -> None:
    async with a_server() as jobs:
        gone = Principal(name="session", transport="http")
        relay, recording, ours = Watch(owner=gone, moves=("/a",)), Watch(owner=gone), Watch(moves=("/b",))
        for job in (relay, recording, ours):
            await jobs.start(job)
        assert await jobs.stop_owned(gone) == [relay] and relay.state == "stopped"
        assert recording.is_running and ours.is_running


async def test_the_end_of_the_server_ends_all_and_lets_none_begin() -> None:
    async with a_server() as jobs:
        watch = Watch()
        await jobs.start(watch)
        await jobs.close()
        assert watch.state == "stopped"
        with pytest.raises(Refused, match="is ending"):
            await jobs.start(Watch())


async def test_no_more_than_the_bound_run_and_only_the_last_that_ended_are_known() -> None:
    async with a_server() as jobs:
        running = [Watch() for _ in range(3)]
        for watch in running:
            await jobs.start(watch)
        with pytest.raises(Refused, match=r"3 watchs run already. Stop one with ros2_watch_stop."):
            await jobs.start(Watch())
        await jobs.start(Other(owner=LOCAL))
        for _ in range(20):
            await jobs.stop(Watch, running.pop().id)
            running.append(Watch())
            await jobs.start(running[-1])
        assert len(jobs.all(Watch)) == 3 + 5


async def test_a_kind_may_let_the_oldest_give_way() -> None:
    class Goal(Watch):
        is_displaced = True

    async with a_server() as jobs:
        goals = [Goal() for _ in range(4)]
        for goal in goals:
            await jobs.start(goal)
        assert await goals[0].wait(20.0)
        assert [goal.is_running for goal in goals] == [False, True, True, True]


def test_the_registry_outlives_the_loop_of_a_command() -> None:
    jobs = Jobs()
    for _ in range(2):
        watch = Watch()
        asyncio.run(jobs.start(watch))
        assert watch.state == "stopped"
