"""Costmaps whose whole and whose parts come on two topics, in any order."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from ros2_mcp.model.nav2 import GRID_UPDATE
from ros2_mcp.model.pictures import OCCUPANCY_GRID
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.navigation.last_costmaps import LastCostmap
from ros2_mcp.robot.values import Values

pytestmark = pytest.mark.anyio
ORIGIN = SimpleNamespace(position=SimpleNamespace(x=0, y=0, z=0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1))
WHOLE = SimpleNamespace(
    header=SimpleNamespace(frame_id="map"),
    info=SimpleNamespace(width=2, height=1, resolution=0.1, origin=ORIGIN),
    data=[0, 0],
)


class Decoding:
    """Values that are known; those of the sample that is named `slow` are decoded when `go_on` is set."""

    def __init__(self, **messages: Any) -> None:
        self.messages = messages
        self.go_on = asyncio.Event()
        self.go_on.set()

    async def decode_all(self, _type_name: str, samples: list[Sample]) -> list[Any]:
        if samples[0].data == b"slow":
            await self.go_on.wait()
        return [self.messages[sample.data.decode()] for sample in samples]


def part(cells: list[int]) -> SimpleNamespace:
    return SimpleNamespace(x=0, y=0, width=len(cells), height=1, data=cells)


async def test_a_later_part_that_is_decoded_sooner_is_not_undone_by_an_earlier_one() -> None:
    decoding = Decoding(whole=WHOLE, slow=part([1, 1]), quick=part([2]))
    kept = LastCostmap("/costmap", cast(Values, decoding), since_ns=0)
    await kept.take_part(GRID_UPDATE, Sample(2, 2, None, b"slow"))  # it has overtaken the whole one
    decoding.go_on.clear()
    whole = asyncio.create_task(kept.take_whole(OCCUPANCY_GRID, Sample(1, 1, None, b"whole")))
    while kept.grid is None:
        await asyncio.sleep(0)
    later = asyncio.create_task(kept.take_part(GRID_UPDATE, Sample(3, 3, None, b"quick")))
    await asyncio.sleep(0)
    decoding.go_on.set()
    await asyncio.gather(whole, later)
    assert kept.grid is not None and kept.grid.cells.tolist() == [[2, 1]]
    assert (kept.updates, kept.newest_ns) == (2, 3)
