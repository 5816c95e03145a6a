"""Hostile names, values and messages through the real page in Chromium: nothing of them runs, and nothing breaks."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.browser import CHROMIUM, browsing
from support.hostile_view import payloads, write_hostile_view
from support.viewing import choose, complaints, pictured, seek, text, viewing

NAME = "<img src=x onerror=hit()>"
"""Of the recording: it becomes the title of the page."""
ELEMENTS = (
    "[...document.querySelectorAll('script, img, iframe, svg, math, a, base, meta, form, style, object, template, b')]"
    ".filter(one => !['SCRIPT', 'STYLE', 'META'].includes(one.tagName) || !document.head.contains(one))"
    ".filter(one => !one.closest('#stop, #agent, body > script')).map(one => one.outerHTML.slice(0, 200))"
)
"""What no text may become; the page itself has one script, and its bold letters in a button and a panel."""


@pytest.mark.parametrize("number", [4, pytest.param(300, marks=pytest.mark.full)])
def test_no_text_of_a_robot_runs_or_breaks_the_page(
    ros_environment: dict[str, str], tmp_path: Path, number: int
) -> None:
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    texts = payloads(number)
    bag = write_hostile_view(tmp_path / NAME, texts)
    with viewing(ros_environment, "--bag", str(bag)) as address, browsing() as page:
        page.look()
        page.open(address)
        page.run("window.hits = 0; window.hit = () => { window.hits++; }; true")
        page.until(f"document.querySelectorAll('#values option').length >= {number}")
        names = page.run("[...document.querySelectorAll('#values option')].map(one => one.value)")
        assert page.run(text("h1")) == NAME
        for at, payload in enumerate(texts):
            page.run(seek(at / 10 + 0.05))  # the slider has steps of 0.05 s
            page.run(choose("values", next(name for name in names if name.startswith(f"/{at} "))))
            tree = text("#values .tree")  # a name of any kind can be chosen, and its value is shown
            page.until(f"{tree} !== '' && !{tree}.includes('#{at - 1}#')")
            page.run(choose("values", "/text"))
            page.until(f"{text('#values .tree')}.includes('#{at}#')")
            assert page.run("[window.hits, document.scripts.length]") == [0, 1], (at, payload)
            assert page.run(ELEMENTS) == [], (at, payload)
            assert page.run("document.getElementById('state').classList.contains('bad')") is False, at
        page.until("document.querySelector('#log li') !== null && document.querySelector('#agent li') !== null")
        pictured(page, "hostile")
        assert page.run("document.documentElement.scrollWidth <= innerWidth")
        assert complaints(page) == []
