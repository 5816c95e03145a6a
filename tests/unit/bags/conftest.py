"""Bags that are closed after the test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from ros2_mcp.bags.bag import Bag


@pytest.fixture
def open_bag() -> Iterator[Callable[[Path], Bag]]:
    with ExitStack() as bags:
        yield lambda path: bags.enter_context(Bag(path))
