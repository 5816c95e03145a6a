"""QoS of publishers as rosbag2 keeps it in a bag."""

import pytest

from ros2_mcp.bags.qos import is_latched, parse_qos, qos_text
from ros2_mcp.model.qos import QoS

LATCHED = QoS(durability="transient_local", depth=1)
STRANGE = QoS("best_effort", "volatile", "keep_all", 0, 20_000_000, 1_500_000_000, "manual_by_topic", 3_000_000_001)
UNTOLD = QoS("unknown", "unknown", "unknown", 0, liveliness="unknown")
IN_WORDS = """\
- history: keep_last
  depth: 5
  reliability: best_effort
  durability: transient_local
  deadline: {sec: 0, nsec: 0}
  lifespan: {sec: 2147483647, nsec: 4294967295}
  liveliness: system_default
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""


def test_what_is_written_is_read_back() -> None:
    assert parse_qos(qos_text([QoS(), LATCHED, STRANGE, UNTOLD])) == (QoS(), LATCHED, STRANGE, UNTOLD)


def test_the_words_of_later_distributions_and_every_spelling_of_infinite_are_understood() -> None:
    assert parse_qos(IN_WORDS) == (QoS("best_effort", "transient_local", depth=5, liveliness="system_default"),)
    assert is_latched(IN_WORDS)


def test_one_latched_publisher_makes_a_topic_latched() -> None:
    assert is_latched(qos_text([QoS(), LATCHED]))
    assert not is_latched(qos_text([QoS()]))


@pytest.mark.parametrize(
    "text", ["", "{", "7", "- 7", "- history: 1", "- {history: 1, depth: 2, reliability: []}", "\0"]
)
def test_a_text_that_says_nothing_is_no_error(text: str) -> None:
    assert parse_qos(text) == ()
    assert not is_latched(text)
