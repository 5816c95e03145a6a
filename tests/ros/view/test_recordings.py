"""The page of a recording in a real Chromium: at any time of it, and two pages of it at once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from ros2_mcp.model.costs import TOUCHING
from ros2_mcp.pictures.palette import cost_colours
from support.browser import CHROMIUM, Page, browsing
from support.room_bag import room_bag
from support.viewing import choose, complaints, pictured, pictured_in_all_sizes, seek, text, viewing

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")

WHERE = "document.querySelector('#map canvas').ariaLabel"


@pytest.fixture(scope="module")
def address(ros_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Of the page of a recording, in which a robot drives 0.25 m a second along x."""
    with viewing(ros_environment, "--bag", str(room_bag(tmp_path_factory.mktemp("bags") / "room"))) as address:
        yield address


@pytest.fixture(scope="module")
def page(address: str) -> Iterator[Page]:
    with browsing() as page:
        page.look()
        page.open(address)
        page.until("document.querySelector('footer input') !== null")
        yield page


def test_a_recording_is_shown_at_any_of_its_times(page: Page) -> None:
    last = page.until(f"/Robot at/.test({WHERE} ?? '') && {WHERE}")
    page.run(seek(1.0))
    page.until(f"/Robot at/.test({WHERE}) && {WHERE} !== {last!r}")
    assert page.run(text("#state")).startswith("recording")
    pictured_in_all_sizes(page, "recording")


def test_two_pages_show_two_times_of_one_recording(page: Page, address: str) -> None:
    with browsing() as other:
        other.look()
        other.open(address)
        other.until("document.querySelector('footer input') !== null")
        page.run(seek(1.0))
        other.run(seek(4.0))
        page.until(f"/Robot at 0.2/.test({WHERE} ?? '')")
        other.until(f"/Robot at (1.0|0.9)/.test({WHERE} ?? '')")
        assert "Robot at 0.2" in page.run(WHERE)
        other.ask("Page.navigate", url="about:blank")
        page.run(seek(2.0))
        page.until(f"/Robot at 0.[45]/.test({WHERE})")


def test_a_costmap_has_the_colours_of_pictures(ros_environment: dict[str, str], tmp_path: Path) -> None:
    """In the dark theme what is free is dark, and every cost has the colour that it has in the light one."""
    bag = room_bag(tmp_path / "costs", costs=True)
    opaque = 0xFF000000  # outside of the grid, lines lie on nothing
    colours = [opaque | red | green << 8 | blue << 16 for red, green, blue in cost_colours().tolist()]
    script = f"""(() => {{
        const canvas = document.querySelector('#map canvas'), counts = new Map();
        const {{ width, height }} = canvas;
        const copy = new OffscreenCanvas(width, height).getContext('2d', {{ willReadFrequently: true }});
        copy.drawImage(canvas, 0, 0);
        const pixels = new Uint32Array(copy.getImageData(0, 0, width, height).data.buffer);
        for (const one of pixels) counts.set(one, (counts.get(one) ?? 0) + 1);
        return {json.dumps(colours)}.map(one => counts.get(one) ?? 0);
    }})()"""
    with viewing(ros_environment, "--bag", str(bag)) as address, browsing() as other:
        for theme in ("light", "dark"):
            other.look(dark=theme == "dark")
            other.open(address)
            other.until("[...document.querySelectorAll('#map option')].some(one => one.value.includes('costmap'))")
            other.run(choose("map", "/global_costmap/costmap"))
            is_free_white = f"{script}[1] > 100" if theme == "light" else f"{script}[1] < 100"
            other.until(f"{script}[{TOUCHING + 1}] > 100 && {is_free_white}")
            _, _, *costs, touching, occupied = other.run(script)
            assert touching > 100 and occupied > 100
            assert sum(count > 10 for count in costs) > 20
            pictured(other, f"costmap-{theme}")
        assert complaints(other) == []
