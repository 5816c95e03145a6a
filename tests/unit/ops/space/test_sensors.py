"""Sensors in words: a line each, and where it must be brief those together that are alike, or at one place."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.space.heads import Head, rate_of
from ros2_mcp.ops.space.sensors import Sensor, rate_in_words, sensors_in_words
from ros2_mcp.ops.space.style import Style

BRIEF = Style(is_brief=True)
PLACED = Style(is_brief=True, has_frames=False)
MOVING = " moving with head_tilt"


def image(topic: str, frame: str, at: str, rate: str = "15 Hz", note: str = "") -> Sensor:
    return Sensor(topic, "Image", rate, frame, at, note)


def test_of_two_sensors_in_one_frame_the_first_tells_where_it_sits() -> None:
    found = [image("/depth", "optical", "0 0 1"), image("/color", "optical", "0 0 1", "10 Hz")]
    told = ["/depth Image 15 Hz in optical at 0 0 1", "/color Image 10 Hz in optical"]
    assert sensors_in_words(found, Style()) == told


def test_a_pair_stands_in_one_line_with_its_frames_and_places_in_order() -> None:
    found = [
        Sensor("/sonar/left", "Range", "10 Hz", "LSonar_frame", "0 0.2 1", sees="0.2 to 2 m"),
        Sensor("/imu", "Imu", "100 Hz", "base_link"),
        Sensor("/sonar/right", "Range", "9.9 Hz", "RSonar_frame", "0 -0.2 1", sees="0.2 to 2 m"),
    ]
    assert sensors_in_words(found, BRIEF) == [
        "/sonar/{left,right} Range 10 Hz in {L,R}Sonar_frame at 0 ±0.2 1, 0.2 to 2 m",
        "/imu Imu 100 Hz in base_link",
    ]


def test_two_kinds_of_pictures_of_several_cameras_are_one_line_and_other_mixtures_are_not() -> None:
    def of(kind: str, side: str) -> Sensor:
        return image(f"/{kind}/{side}/image", f"{side}_optical", f"{len(side)} 0 0", "7 Hz")

    found = [of(kind, side) for kind in ("camera", "depth") for side in ("back", "left", "right")]
    assert sensors_in_words(found, BRIEF) == [
        "/{camera,depth}/{back,left,right}/image Image 7 Hz in {back,left,right}_optical at 4 0 0; 4 0 0; 5 0 0"
    ]
    mixed = [image("/a/x", "one", "1 0 0"), image("/b/y", "one", "1 0 0"), image("/c/z", "two", "2 0 0")]
    mixed += [image("/d/w", "two", "2 0 0")]
    assert sensors_in_words(mixed, BRIEF) == [
        "/a/x, /b/y Image 15 Hz in one at 1 0 0",
        "/c/z, /d/w Image 15 Hz in two at 2 0 0",
    ], "which of four is in which of two frames would have to be guessed"


def test_without_their_frames_sensors_at_one_place_stand_together_and_an_unknown_place_has_its_frame() -> None:
    found = [
        image("/color", "color_optical", "0 0 1.3 25° down", note=MOVING),
        Sensor("/points", "PointCloud2", "15 Hz", "depth_optical", "0 0 1.3 25° down", MOVING),
        Sensor("/imu", "Imu", "30 Hz", "imu_mobile_base", note=" (mount unknown)"),
        Sensor("/mag", "MagneticField", "30 Hz", "imu_mobile_base", note=" (mount unknown)"),
        Sensor("/battery", "BatteryState", "74%, 2 Hz"),
    ]
    assert sensors_in_words(found, PLACED) == [
        "at 0 0 1.3 25° down (moves): /color Image 15 Hz; /points PointCloud2 15 Hz",
        "in imu_mobile_base: /imu Imu 30 Hz; /mag MagneticField 30 Hz",
        "/battery BatteryState 74%, 2 Hz",
    ]


def test_rates_that_differ_are_told_each_and_nearly_equal_ones_as_one() -> None:
    def told(*rates: str) -> str:
        found = [image(f"/c_{number}", "optical", "", rate) for number, rate in enumerate(rates)]
        return sensors_in_words(found, BRIEF)[0].split("Image ")[1].split(" in")[0]

    assert told("7.4 Hz", "7.6 Hz") == "7.5 Hz"
    assert told("50 Hz", "10 Hz") == "50, 10 Hz"


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


def test_how_wide_cameras_see_is_told_of_each() -> None:
    views = {"color": "69", "depth": "87"}
    found = [replace(image(f"/{name}/image", "o", "1 0 0"), view=view) for name, view in views.items()]
    assert sensors_in_words(found, Style())[0] == "/color/image Image 15 Hz 69° wide in o at 1 0 0"
    assert sensors_in_words(found, BRIEF) == ["/{color,depth}/image Image 15 Hz 69, 87° wide in o at 1 0 0"]


def test_a_kept_message_that_is_received_at_once_makes_no_rate_higher() -> None:
    """Spot's driver keeps its pictures for whoever comes later: the first of them was sent a while ago."""
    times_ms = ((900, 860), (1_003, 1_000), (1_143, 1_140))
    samples = [Sample(received * 10**6, sent * 10**6, None, b"") for received, sent in times_ms]
    assert rate_of(samples) == pytest.approx(2 / 0.28)
