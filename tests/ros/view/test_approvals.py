"""What waits for a person: the page in a real Chromium shows it as waiting, and what `ros2-mcp operate` answers."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

from support.agent import Agent, agent_for
from support.browser import CHROMIUM, Page, browsing
from support.observer import Observer
from support.velocities import TWIST
from support.viewing import complaints, pictured, pictured_in_all_sizes, text, viewing

TOPIC = "/cmd_vel"
ROWS = "[...document.querySelectorAll('#agent .rows:last-of-type li')]"


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A policy of a robot where a person confirms each command."""
    file = tmp_path / "policy.yaml"
    rule = f"{{publish: {TOPIC}, type: {TWIST}, rate_hz: 50, for_s: 10}}"
    file.write_text(f"policy: 1\nname: hall-3\nrobot: hall-3\nmode: confirm\nstate: {tmp_path}\nallow: [{rule}]\n")
    file.chmod(0o600)
    return file


def asked(agent: Agent, page: Page, speed: float) -> str:
    """Asks for a command, which then waits, and looks at the page: its id."""
    refusal = agent.refusal("ros2_topic_publish", topic_name=TOPIC, data={"linear": {"x": speed}})
    request = refusal.partition("needs_approval ")[2][:4]
    told = page.until(f"{text('#agent')}.includes('{request} waits for a person') && {text('#agent .waits')}")
    assert f"Publish on {TOPIC}" in told and f"linear.x {speed} m/s" in told  # what
    assert "For the client" in told and re.search(r"asked \d+ s ago, \d+ s left", told)  # who, since when
    assert ended(page, request) == "waits"
    page.until(f"{text('#moves')} .startsWith('1 request needs you · ')")
    return request


def ended(page: Page, request: str) -> str:
    """What stands at the end of the only line of a call that waits or has waited."""
    lines = f"{ROWS}.filter(row => row.querySelector('small')?.textContent.includes('{request}'))"
    return page.until(f"{lines}.map(row => row.querySelector('.end').textContent).at(-1)")


def answered(page: Page, state: Path, request: str, *words: str) -> str:
    """Answers it in a terminal; what the page makes of it, once nothing waits there any more."""
    command = [sys.executable, "-m", "ros2_mcp", "operate", "--state", str(state), words[0], request, *words[1:]]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    page.until(f"document.querySelector('#agent .waits') === null && !{text('#moves')}.includes('WAITS')")
    page.until(f"!{ROWS}.some(row => row.querySelector('.end').textContent === 'waits')")
    return ended(page, request)


def test_what_waits_for_a_person_is_shown_until_it_is_answered_and_then_how(
    ros_environment: dict[str, str], observer: Observer, policy: Path
) -> None:
    if not CHROMIUM:
        pytest.skip("needs Chromium")
    observer.watch(TOPIC)
    state = policy.parent / "hall-3"
    with (
        agent_for(ros_environment, "--policy", str(policy)) as agent,
        viewing(ros_environment, "--state", str(state)) as address,
        browsing() as page,
    ):
        agent.knows(TOPIC)
        page.look()
        page.open(address)
        denied = asked(agent, page, 0.3)
        assert answered(page, state, denied, "deny") == "denied"
        assert "denied" in agent.refusal("ros2_topic_publish", topic_name=TOPIC, data={"linear": {"x": 0.3}})
        approved = asked(agent, page, 0.1)
        assert page.run(text("#agent .answer code")) == "ros2-mcp operate"
        assert page.run("document.querySelector('#image.bare').clientHeight < 60")  # no camera: a line
        for width in (1440, 820, 390):  # and what waits is seen, in every width
            page.look(width=width)
            page.until("document.querySelector('#agent .waits').getBoundingClientRect().bottom < innerHeight")
            assert page.run("document.documentElement.scrollWidth <= innerWidth")
        page.look()
        pictured(page, "waits", of="#agent")
        pictured_in_all_sizes(page, "waits")
        assert answered(page, state, approved, "approve") == "approved"
        assert not any(observer.driven(topic=TOPIC).values())
        agent.call("ros2_topic_publish", topic_name=TOPIC, data={"linear": {"x": 0.1}})
        observer.until_driven(TOPIC)
        granted = asked(agent, page, 0.2)
        assert answered(page, state, granted, "grant", "60") == "granted"
        page.until(f"{text('#agent .foot')}.includes('Granted: publish {TOPIC}')")
        assert re.search(r"Granted: .*, \d+ s left", page.run(text("#agent .foot")))
        agent.call("ros2_topic_publish", topic_name=TOPIC, data={"linear": {"x": 0.25}})
        named = f"row.querySelector('code')?.textContent === '{TOPIC}'"
        page.until(f"{ROWS}.filter(row => {named} && row.querySelector('.end').textContent === 'done').length === 2")
        pictured_in_all_sizes(page, "answered")
        assert complaints(page) == []
