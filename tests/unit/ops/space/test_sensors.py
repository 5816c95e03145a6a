"""Sensors in words: one line for each, with its place and what it sees."""

from __future__ import annotations

import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.space.heads import Head, rate_of
from ros2_mcp.ops.space.sensors import Sensor, rate_in_words


def test_each_sensor_tells_where_it_sits_also_where_another_sits_in_the_same_frame() -> None:
    for topic in ("/depth", "/color"):
        sensor = Sensor(topic, "Image", "15 Hz", "optical", "0 0 1", view="69")
        assert sensor.line == f"{topic} Image 15 Hz 69° wide in optical at 0 0 1"


def test_what_is_not_known_of_a_sensor_is_left_out_and_how_it_moves_and_what_it_sees_are_told() -> None:
    sonar = Sensor("/sonar/left", "Range", "10 Hz", "sonar", "0 0.2 1", " moving with head_tilt", "0.2 to 2 m")
    assert sonar.line == "/sonar/left Range 10 Hz in sonar at 0 0.2 1 moving with head_tilt, 0.2 to 2 m"
    assert (
        Sensor("/imu", "Imu", "30 Hz", "imu", note=" (mount unknown)").line == "/imu Imu 30 Hz in imu (mount unknown)"
    )
    assert Sensor("/battery", "BatteryState", "74%, 2 Hz").line == "/battery BatteryState 74%, 2 Hz"
    assert Sensor("/points", "PointCloud2").line == "/points PointCloud2"


@pytest.mark.parametrize(
    ("head", "told"),
    [
        (Head(9, 40.13, ""), "40 Hz"),
        (Head(9, 9.96, ""), "10 Hz"),
        (Head(9, 7.63, ""), "7.6 Hz"),
        (Head(1, None, "", is_rare=True), "under 2 Hz"),
        (Head(1, None, ""), ""),
        (Head(0, None, ""), ""),
    ],
)
def test_a_rate_has_two_digits_and_of_one_message_only_how_seldom_it_comes(head: Head, told: str) -> None:
    assert rate_in_words(head) == told


def test_a_kept_message_that_is_received_at_once_makes_no_rate_higher() -> None:
    """Spot's driver keeps its pictures for whoever comes later: the first of them was sent a while ago."""
    times_ms = ((900, 860), (1_003, 1_000), (1_143, 1_140))
    samples = [Sample(received * 10**6, sent * 10**6, None, b"") for received, sent in times_ms]
    assert rate_of(samples) == pytest.approx(2 / 0.28)
