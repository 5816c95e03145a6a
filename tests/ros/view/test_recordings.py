"""The page of a recording in a real Chromium: at any time of it, and two pages of it at once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.browser import CHROMIUM, Page, browsing
from support.room_bag import room_bag
from support.viewing import pictured_in_all_sizes, seek, text, viewing

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
