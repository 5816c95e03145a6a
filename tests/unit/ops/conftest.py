"""Windows of signals made for the purpose."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pytest

from ros2_mcp.codec.definitions import Definitions
from ros2_mcp.model.samples import Sample
from support.made_windows import CODEC, START_NS, Make, Window, encoded


@pytest.fixture
def definitions() -> Definitions:
    return CODEC.definitions


@pytest.fixture
def window() -> Make:
    """A window: `window("/x", "std_msgs/msg/Float64", [(0.1, {"data": 1.0}), …], duration_s=5.0)`; times in seconds."""

    def make(
        topic: str,
        type_name: str,
        messages: Iterable[tuple[float, Mapping[str, Any]]],
        duration_s: float = 5.0,
        **more: Any,
    ) -> Window:
        samples = [
            Sample(START_NS + round(at * 1e9), 0, None, encoded(type_name, value)) for at, value in messages
        ]  # fmt: skip
        end_ns = START_NS + round(duration_s * 1e9)
        return Window(
            topic=topic,
            type=type_name,
            codec=CODEC,
            samples=samples,
            start_ns=START_NS,
            end_ns=end_ns,
            **more,
        )

    return make
