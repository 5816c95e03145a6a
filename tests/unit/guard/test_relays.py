"""Relays that lead in a circle are found, whatever their length."""

from __future__ import annotations

from ros2_mcp.guard.relays import Relay, Relays

STRING = "std_msgs/msg/String"


def relays(*ways: tuple[str, str]) -> Relays:
    found = Relays()
    for source, destination in ways:
        relay_id = found.new_id()
        found.add(Relay(relay_id, source, destination, STRING, STRING, "identity", None, 0.0, {}, {}, False))
    return found


def test_a_way_along_several_relays_is_found() -> None:
    known = relays(("/a", "/b"), ("/b", "/x"), ("/b", "/c"), ("/c", "/d"))
    assert known.way("/a", "/d") == ["/a", "/b", "/c", "/d"]
    assert known.way("/d", "/a") == []


def test_a_circle_of_others_ends_the_search() -> None:
    assert relays(("/a", "/b"), ("/b", "/a")).way("/a", "/z") == []


def test_a_relay_that_has_ended_leads_nowhere() -> None:
    known = relays(("/a", "/b"))
    next(iter(known.known.values())).state = "stopped"
    assert known.way("/a", "/b") == []


def test_only_the_last_relays_that_ended_are_remembered() -> None:
    known = relays(("/kept", "/open"))
    for _ in range(50):
        ended = Relay(known.new_id(), "/a", "/b", STRING, STRING, "identity", None, 0.0, {}, {}, False, state="ended")
        known.add(ended)
    assert len(known.known) == 21
    assert [relay.source for relay in known.open] == ["/kept"]
