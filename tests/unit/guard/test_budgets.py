"""Budgets of work that is under way."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from ros2_mcp.guard import budgets
from ros2_mcp.guard.budgets import Budgets
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import Refused

ONE, OTHER, THIRD = (Principal(name=name, transport="http") for name in ("one", "other", "third"))


def test_one_principal_has_a_bound_of_its_own_that_leaves_the_others_theirs() -> None:
    work, held = Budgets(), ExitStack()
    with held:
        for _ in range(budgets.MOST_ACTS):
            held.enter_context(work.work(ONE))
        with pytest.raises(Refused, match=f"{budgets.MOST_ACTS} commands of yours are under way"), work.work(ONE):
            pass
        with work.work(OTHER):
            pass
    with work.work(ONE):
        pass


def test_the_names_that_clients_of_one_login_give_themselves_share_its_bound() -> None:
    work = Budgets()
    with ExitStack() as held:
        for number in range(budgets.MOST_ACTS):
            held.enter_context(work.work(Principal(name=f"client {number}", transport="http", login="laptop")))
        another = Principal(name="another client", transport="http", login="laptop")
        with pytest.raises(Refused, match="of yours"), work.work(another):
            pass


def test_all_together_have_a_bound() -> None:
    work = Budgets()
    with ExitStack() as held:
        for principal in (ONE, OTHER):
            for _ in range(budgets.MOST_ACTS):
                held.enter_context(work.work(principal))
        with pytest.raises(Refused, match="of all clients"), work.work(THIRD):
            pass


def test_rates_add_up_and_are_given_back() -> None:
    work = Budgets()
    with ExitStack() as held:
        for _ in range(5):
            held.enter_context(work.work(ONE, 1000))
        with pytest.raises(Refused, match="5000 messages a second of yours"), work.work(ONE, 0.5):
            pass
        held.enter_context(work.work(ONE))  # what is sent once has no rate
        held.enter_context(work.work(OTHER, 5000))
        with pytest.raises(Refused, match="of all clients"), work.work(THIRD, 1):
            pass
    with work.work(ONE, 5000):
        pass


def test_what_is_refused_or_fails_takes_nothing() -> None:
    work = Budgets()
    for _ in range(3 * budgets.MOST_ACTS):
        with pytest.raises(ValueError, match="failed"), work.work(ONE, 3000):
            raise ValueError("failed")
        with work.work(ONE, 3000), pytest.raises(Refused), work.work(ONE, 3000):
            pass
    assert work == Budgets()
