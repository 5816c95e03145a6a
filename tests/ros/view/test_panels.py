"""The panels that share a place with others, in a real Chromium beside the simulated robot."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import until
from support.browser import CHROMIUM, Page, browsing
from support.processes import peer_command, running
from support.viewing import complaints

PICTURES = os.environ.get("ROS2_MCP_PICTURES")
"""A folder for what the page looked like, to be looked at by a person."""
LOOKS = (("wide", 1440, 900), ("middle", 900, 800), ("narrow", 390, 800))


@pytest.fixture(scope="module")
def page(demo_environment: dict[str, str], demo_robot: object) -> Iterator[Page]:
    """The page of the simulated robot."""
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    view = running(demo_environment, sys.executable, "-m", "ros2_mcp", "view")
    with (
        running(demo_environment, *peer_command("cloud_peer", "laser")),
        view as process,
        browsing(graphics=True) as page,
    ):
        assert process.stdout
        page.look()
        page.open(process.stdout.readline().strip())
        yield page
        assert complaints(page) == []


def show(page: Page, panel: str) -> None:
    """Shows a panel that shares its place."""
    page.run(f"document.querySelector('[aria-controls={panel}]').click()")


def picked(environment: dict[str, str]) -> dict[str, Any]:
    """What was picked, as it is kept for the agent's server."""
    (kept,) = Path(environment["XDG_STATE_HOME"]).glob("ros2-mcp/*/picked.json")
    (one,) = json.loads(kept.read_text())["picks"]
    return one


def pictured(page: Page, panel: str, named: str = "") -> None:
    """Keeps what a panel looks like in both themes and three widths, where that is wanted."""
    if not PICTURES:
        return
    for dark in (False, True):
        for name, width, height in LOOKS:
            page.look(width=width, height=height, dark=dark)
            page.run(f"document.getElementById('{panel}').scrollIntoView()")
            page.run("new Promise(done => setTimeout(done, 400))")
            page.picture(Path(PICTURES) / f"{named or panel}-{name}-{'dark' if dark else 'light'}.jpg")
    page.look()
    page.run(f"document.querySelector('#{panel} .enlarge').click()")
    page.run("new Promise(done => setTimeout(done, 700))")
    page.picture(Path(PICTURES) / f"{named or panel}-large.jpg")
    page.run(f"document.querySelector('#{panel} .enlarge').click()")


def test_each_frame_stands_below_its_parent_with_who_tells_it(page: Page) -> None:
    assert page.run("document.querySelector('#frames tbody')?.textContent ?? ''") == ""  # hidden: not asked for
    show(page, "frames")
    row = "[...document.querySelectorAll('#frames tr')].find(row => /^base_link\\b/.test(row.textContent))"
    told = page.until(f"{row} && /\\d Hz/.test({row}.textContent) && {row}.textContent")
    assert "base_link in base_footprint" in told or "base_link in odom" in told
    assert "/" in told  # the node that tells it
    page.until("/^\\d+ frames · /.test(document.querySelector('#frames .age').textContent)")
    pictured(page, "frames")


def test_numbers_are_drawn_over_time_and_what_stands_still_looks_old(
    page: Page, demo_robot: subprocess.Popen[bytes], demo_environment: dict[str, str]
) -> None:
    show(page, "plot")
    told = "document.querySelector('#plot .sheet').ariaLabel ?? ''"
    page.until(rf"/twist\.twist\.linear\.x -?[\d.]+ m\/s, between/.test({told})")
    assert page.run("document.querySelector('#plot canvas').width > 300")
    page.run("[...document.querySelectorAll('.curves button')].find(one => one.title.endsWith('position.x')).click()")
    page.until(f"{told}.includes('pose.pose.position.x')")
    demo_robot.send_signal(signal.SIGSTOP)
    try:
        page.until("document.getElementById('plot').classList.contains('stale')")
    finally:
        demo_robot.send_signal(signal.SIGCONT)
    page.until("!document.getElementById('plot').classList.contains('stale')")
    left, top, width, height = page.rectangle("#plot .u-over")
    page.click(left + width - 60, top + height / 2)
    page.until("document.querySelector('#plot .picked')?.textContent.includes('The agent sees it')")
    pictured(page, "plot")
    time = picked(demo_environment)
    assert (time["kind"], time["topic"]) == ("time", "/odom") and time["age_s"] > 0.0
    assert "m/s" in [one["unit"] for one in time["values"]]


def test_clouds_scans_and_frames_stand_in_one_space(page: Page, demo_environment: dict[str, str]) -> None:
    show(page, "space")
    told = "document.querySelector('#space canvas').ariaLabel"
    page.until(f"/Robot at .* in map.*4376 points of .cloud, 1 scan, /.test({told})")
    assert "to map" not in page.run("document.querySelector('#space .foot').textContent")
    page.until("[...document.querySelectorAll('#space .names span')].some(one => one.textContent === 'camera_link')")
    left, top, width, height = page.rectangle("#space canvas")
    page.click(left + width / 2 + 40, top + height / 2 + 40)  # the floor beside the robot
    page.until("document.querySelector('#space .picked')?.textContent.includes('The agent sees it')")
    pictured(page, "space")
    point = picked(demo_environment)
    assert (point["kind"], point["topic"], point["frame"], point["view_frame"]) == ("point", "/cloud", "laser", "map")
    assert (
        (point["z_m"], len(point["view_xyz_m"])) == (0.0, 3) and abs(point["x_m"]) <= 4.0 and abs(point["y_m"]) <= 2.0
    )
    page.run("document.querySelector('.picked button:last-child').click()")
    page.until("document.querySelector('.picked').hidden")


def test_graphics_that_drop_the_picture_are_told_and_give_it_back(page: Page) -> None:
    canvas, why = "document.querySelector('#space canvas')", "document.querySelector('#space .why').textContent"
    show(page, "space")
    page.until(f"{canvas}.ariaLabel?.includes('Robot at')")  # drawn: else the test, and not the page, has its context
    page.run(f"(window.graphics = {canvas}.getContext('webgl2').getExtension('WEBGL_lose_context')).loseContext()")
    page.until(f"{why}.includes('dropped the picture')")
    page.run("graphics.restoreContext()")
    page.until(f"{why} === ''")
    copy = "const copy = new OffscreenCanvas(40, 30).getContext('2d'); copy.drawImage(" + canvas + ", 0, 0, 40, 30);"
    pixels = "const pixels = [...new Uint32Array(copy.getImageData(0, 0, 40, 30).data.buffer)];"
    light = "pixels.filter(pixel => (pixel & 255) > 128).length"
    colours = f"[new Set(pixels).size, {light}]"
    drawn = f"new Promise(done => requestAnimationFrame(() => {{ {copy} {pixels} done({colours}); }}))"
    # Lines and points again, in more than a colour, and the ground is that of the light theme.
    until(lambda: (found := page.run(drawn)) and found[0] > 5 and found[1] > 1000)


def test_graphics_that_do_not_come_back_leave_the_map_which_says_so(page: Page) -> None:
    show(page, "space")
    is_large = "document.getElementById('{}').classList.contains('large')"
    page.run("document.querySelector('#space .enlarge').click()")
    page.run("window.usual = setTimeout, window.setTimeout = (work, ms) => usual(work, ms / 40), true")  # 8 s: 0.2
    page.run("graphics.loseContext()")
    page.until(f"{is_large.format('map')} && !{is_large.format('space')}")
    page.until("document.querySelector('#map .foot').textContent.includes('3D is off')")
    pictured(page, "map", "without-graphics")
    show(page, "space")
    page.until("document.querySelector('#space .why').textContent.includes('3D is off')")
    page.run("window.setTimeout = usual, graphics.restoreContext()")
    page.until("!document.querySelector('#space canvas').hidden && document.querySelector('#space .why').hidden")
    page.run("document.querySelector('#space .enlarge').click()")
    show(page, "map")
    page.until("!document.querySelector('#map .foot').textContent.includes('3D is off')")


def test_the_robots_meshes_and_all_kinds_of_markers_are_drawn_and_what_is_not_says_why(
    page: Page, demo_environment: dict[str, str], tmp_path: Path
) -> None:
    mesh = tmp_path / "body.stl"
    mesh.write_bytes(pyramid())
    with running(demo_environment, *peer_command("marker_peer", f"file://{mesh}")):
        show(page, "space")
        told = "document.querySelector('#space canvas').ariaLabel"
        page.until(f"/1 shapes of the robot, 1 of them meshes, 14 markers/.test({told})")
        missing = page.run("document.querySelector('#space .foot').textContent")
        assert "package://nowhere/a.dae is not drawn: The package nowhere is not on this machine" in missing
        assert "no transform leads from nowhere to map" in missing
        assert page.run("/^[5-9] things/.test(document.querySelector('#space .foot summary').textContent)")
        assert "3 more" in missing or ("not finite" in missing and "the type 99" in missing)
        assert page.run("document.querySelector('#space .names .written').textContent") == "<b>a pallet</b>"
        pictured(page, "space", "markers")
        # The map is hidden, and so not asked for: its silence is not the robot's.
        page.until("document.getElementById('state').textContent === 'live'")
    assert complaints(page) == []


def pyramid() -> bytes:
    """An STL of four triangles, 0.4 m wide."""
    top, feet = (0.0, 0.0, 0.3), ((0.2, 0.0, 0.0), (-0.2, 0.2, 0.0), (-0.2, -0.2, 0.0))
    faces = [feet, *((feet[at], feet[at - 1], top) for at in range(3))]
    rows = [struct.pack("<12fH", 0, 0, 0, *(part for corner in face for part in corner), 0) for face in faces]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def test_without_webgl_it_says_so_and_the_rest_works(page: Page) -> None:
    without = "HTMLCanvasElement.prototype.getContext = (get => function (kind, ...more) {"
    without += " return kind.startsWith('webgl') ? null : get.call(this, kind, ...more); })"
    without += "(HTMLCanvasElement.prototype.getContext)"
    page.ask("Page.addScriptToEvaluateOnNewDocument", source=without)
    page.ask("Page.reload")
    page.until("document.querySelector('#image canvas')?.ariaLabel")
    show(page, "space")
    page.until("document.querySelector('#space .why').textContent.includes('no WebGL')")
    show(page, "frames")
    page.until("document.querySelectorAll('#frames tbody tr').length > 3")
