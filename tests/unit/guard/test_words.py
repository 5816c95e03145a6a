"""What a policy says in words, and how strong it says that it is."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from ros2_mcp.guard import words
from ros2_mcp.guard.policy_file import document_of
from ros2_mcp.guard.strength import strength_of
from ros2_mcp.settings import Settings

WHOLE = """
policy: 1
allow:
  - {publish: [/a, /**/b], types: [p/msg/A, p/msg/B], rate_hz: 7, for_s: 8, per_minute: 9, sole_publisher: true}
  - {relay: /c, type: p/msg/A, from: /src}
  - {play: /c, type: p/msg/A, force: true}
  - {call: /d, type: p/srv/D, consent: never, fields: {e: {in: [1, x, true]}, f: {is: 3}}}
  - {call: /m, type: p/srv/M, meta: true}
  - {call: /n, type: p/srv/*}
  - {goal: /g, type: p/action/G, consent: each,
     fields: {h: {zone: z}, i: {count: [1, 4]}, j: {zero: true}, k: {norm: 5}}}
  - {goal: /t, type: p/action/T, fields: {points: {pace: {most: 0.3, first_s: 2}}}}
  - {cancel: /g}
  - {set: /node, names: [speed], fields: {speed: {range: [0, 6]}}}
  - {transition: /node, transitions: [activate]}
  - {record: /scan}
forbid: [{publish: /joy}, {types: [q/**]}]
limits:
  l: {types: [p/msg/A], names: [/a], norm: {v: 0.25}, ramp: {v: {up: 0.5, down: 2.5}}, hold_s: 0.75,
      over: {tool: clamp, stream: refuse}}
zones: {z: {frame: map, polygon: [[0, 0], [11, 0], [11, 12]], margin_m: 0.1}}
feedback: {topic: /odom, within_s: 1.5}
pose: {topic: /amcl_pose, zone: z}
"""


@pytest.mark.promise("ros2_policy", "what this server's policy allows, in words and numbers")
def test_every_part_of_a_policy_is_said() -> None:
    document = document_of(WHOLE, "whole")
    rules = document.rules
    text = "\n".join(
        [*words.allowed(rules), *words.limits(rules), *words.forbidden(rules), *words.watched(document, {})]
    )
    for said in (
        "Publish p/msg/A or p/msg/B on /a or b in any namespace: at most 7 Hz; for at most 8 s each time",
        "at most 9 times a minute",
        "only where no node of the robot publishes",
        "Relay p/msg/A to /c: from /src",
        "also where others publish",
        "e 1, 'x' or true; f 3; no approval is needed",
        "also what changes the robot's set-up",
        "Call /n (p/srv/*): not what changes the robot's set-up",
        "/odom tells the robot's speed. It is stopped, and the latch set, when it still moves 1.5 s after its zero "
        "(more than 0.03 m/s or 0.05 rad/s) or it is driven for 0.5 s without having told it. How fast a velocity or a "
        "goal drives it is not judged.",
        "/amcl_pose tells the robot's place in the frame map. It is stopped, and the latch set, when it would leave "
        "the zone z though it braked with 1 m/s² or it is driven for 1 s without having told it. Once it is outside",
        "a person approves each",
        "h in the zone z",
        "i with 1 to 4 elements",
        "j 0",
        "the length of k at most 5",
        "points at most 0.3 per second between points, the first not before 2 s",
        "Cancel any client's goals of /g",
        "Set parameters of /node: only speed; speed from 0 to 6",
        "only activate",
        "Record /scan",
        "Publish on /joy with any type",
        "Everything on any name with q/**",
        "p/msg/A on /a: the length of v at most 0.25; v grows by at most 0.5 per second",
        "v shrinks by at most 2.5 per second",
        "the zero follows 0.75 s after the last command; what is beyond is scaled down",
        "held back in relays and playbacks",
        "The zone z in the frame map has the corners (0, 0), (11, 0), (11, 12) m, 0.1 m from its edges",
    ):
        assert said in text, said


def test_a_policy_is_never_called_enforced_where_the_agent_may_be_the_same_user(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    account = pwd.getpwuid(os.getuid())

    def as_user(uid: int, shell: str) -> None:
        monkeypatch.setattr(os, "geteuid", lambda: uid)
        monkeypatch.setattr(pwd, "getpwuid", lambda _: pwd.struct_passwd((*account[:6], shell)))

    as_user(990, "/usr/sbin/nologin")
    apart = Settings(transport="streamable-http"), Settings(socket=Path("/run/ros2-mcp.sock"))
    assert [strength_of(settings) for settings in apart] == ["enforced", "enforced"]
    assert strength_of(Settings()) == "advisory"
    for uid, shell in ((1000, "/bin/bash"), (0, "/usr/sbin/nologin")):
        as_user(uid, shell)
        assert [strength_of(settings) for settings in apart] == ["advisory", "advisory"]
