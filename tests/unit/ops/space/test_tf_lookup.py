"""Looking a transform up in a recording: at a time, over a time, of points and of fields of messages."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from ros2_mcp.model.errors import BadInput, BadValue, NoTransform
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.space.frames import pose_in
from ros2_mcp.ops.space.tf_lookup import LookupRequest, tf_lookup
from support.made_windows import START_NS, Make, Recorded, Window

TF = "tf2_msgs/msg/TFMessage"
SECOND = 1_000_000_000


def tf(frame: str, child: str, x: float, y: float, yaw: float = 0.0, at_s: float = 0.0) -> dict[str, Any]:
    sec, nanosec = divmod(START_NS + round(at_s * SECOND), SECOND)
    return {
        "header": {"frame_id": frame, "stamp": {"sec": sec, "nanosec": nanosec}},
        "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": y},
            "rotation": {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
        },
    }


def windows(window: Make) -> list[Window]:
    """map → odom stands still, the base drives 1 m/s along x of odom for four seconds; the laser is turned by 90°."""
    moving = [
        (tick / 10, {"transforms": [tf("odom", "base_link", tick / 10, 0.0, at_s=tick / 10)]}) for tick in range(41)
    ]
    slow = [(float(tick), {"transforms": [tf("map", "odom", 10.0, 0.0, at_s=tick)]}) for tick in range(5)]
    static = [(0.0, {"transforms": [tf("base_link", "laser", 0.5, 0.0, math.pi / 2)]})]
    return [window("/tf", TF, sorted(moving + slow, key=lambda pair: pair[0])), window("/tf_static", TF, static)]


@pytest.fixture
def recorded(window: Make) -> Recorded:
    return Recorded(windows(window))


def request(target: str = "map", frame: str = "laser", **more: Any) -> LookupRequest:
    return LookupRequest(target=target, frame=frame, **more)


async def test_the_latest_pose_comes_with_its_time_its_chain_and_its_edges(recorded: Recorded) -> None:
    found = await tf_lookup(recorded, request())
    assert (found.translation.x, found.translation.y) == pytest.approx((14.5, 0.0))
    assert (found.roll_deg, found.pitch_deg, found.yaw_deg) == pytest.approx((0.0, 0.0, 90.0))
    assert found.stamp_ns == str(START_NS + 4 * SECOND)
    assert found.chain == ["laser", "base_link", "odom", "map"]
    assert [(row.parent, row.child, row.is_static) for row in found.edges] == [
        ("base_link", "laser", True),
        ("odom", "base_link", False),
        ("map", "odom", False),
    ]
    assert [row.rate_hz for row in found.edges] == [None, 10.0, 1.0]
    first, by = found.summary()[0], found.summary()[1]
    assert first.startswith("laser in map (at 2023-11-14T22:13:24.000000Z") and "x 14.5000" in first
    assert "odom → base_link (10 Hz" in by


async def test_a_pose_is_interpolated_at_the_time_that_is_asked_for(recorded: Recorded) -> None:
    found = await tf_lookup(recorded, request(time=f"{START_NS / 1e9 + 2.55:.2f}"))
    assert found.translation.x == pytest.approx(13.05)
    assert (await pose_in(recorded, "odom", "base_link", START_NS + SECOND // 4)).pose.translation[0] == 0.25


async def test_a_time_that_is_not_there_is_an_error_that_names_the_nearest(recorded: Recorded) -> None:
    with pytest.raises(NoTransform, match=r"the nearest is 2 s earlier"):
        await tf_lookup(recorded, request(time=str(START_NS + 6 * SECOND)))
    with pytest.raises(NoTransform, match=r"Did you mean laser\?"):
        await tf_lookup(recorded, request(frame="lasr"))


async def test_over_a_duration_the_answer_is_the_mean_with_its_spread(recorded: Recorded) -> None:
    found = await tf_lookup(recorded, request("odom", "base_link", duration_s=2.0))
    assert found.translation.x == pytest.approx(3.0)
    assert found.spread
    assert (found.spread.count, found.spread.moved_m, found.spread.max_deviation_m) == (
        21,
        pytest.approx(2),
        pytest.approx(1),
    )
    assert found.spread.std_x_m == pytest.approx(math.sqrt(sum((n / 10) ** 2 for n in range(-10, 11)) / 21))
    still = await tf_lookup(recorded, request("base_link", "laser", duration_s=2.0))
    assert still.is_static and still.spread and still.spread.max_deviation_m == 0.0


async def test_points_and_poses_of_one_frame_are_given_in_the_other(recorded: Recorded) -> None:
    found = await tf_lookup(recorded, request(points=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]))
    assert found.transformed
    assert found.transformed[0] == pytest.approx((14.5, 1.0, 0.0))
    assert found.transformed[1] == pytest.approx((14.5, 0.0, 0.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    with pytest.raises(BadValue, match=r"points\[0\]: 2 numbers"):
        await tf_lookup(recorded, request(points=[[1.0, 2.0]]))
    with pytest.raises(BadValue, match="quaternion has length 0"):
        await tf_lookup(recorded, request(points=[[1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))


@pytest.mark.parametrize(
    ("topic_type", "path", "value", "expected"),
    [
        ("geometry_msgs/msg/PointStamped", "point", {"point": {"x": 1.0}}, [(12.5, 1.0, 0.0)]),
        ("geometry_msgs/msg/PointStamped", "", {"point": {"x": 1.0}}, [(12.5, 1.0, 0.0)]),
        ("geometry_msgs/msg/Vector3Stamped", "vector", {"vector": {"x": 1.0}}, [(0.0, 1.0, 0.0)]),
        ("geometry_msgs/msg/PolygonStamped", "", {"polygon": {"points": [{"x": 1.0}, {"y": 1.0}]}},
         [(12.5, 1.0, 0.0), (11.5, 0.0, 0.0)]),
        ("nav_msgs/msg/Path", "poses[0].pose", {"poses": [{"pose": {"position": {"x": 2.0}}}]},
         [(12.5, 2.0, 0.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))]),
    ],
)  # fmt: skip
async def test_a_field_of_a_message_is_given_from_its_frame_at_its_stamp(
    window: Make, topic_type: str, path: str, value: dict[str, Any], expected: list[tuple[float, ...]]
) -> None:
    stamp = {"sec": START_NS // SECOND + 2, "nanosec": 0}
    message = {"header": {"frame_id": "laser", "stamp": stamp}, **value}
    seen = Recorded([*windows(window), window("/seen", topic_type, [(2.1, message)])])
    found = await tf_lookup(seen, request(frame="", field=f"/seen:{path}" if path else "/seen"))
    assert found.stamp_ns == str(START_NS + 2 * SECOND)
    assert found.transformed and len(found.transformed) == len(expected)
    for one, other in zip(found.transformed, expected, strict=True):
        # the laser is at x = 12.5 then, and turned by 90°
        shifted = (other[0], *other[1:]) if len(other) == 3 else other
        assert one == pytest.approx(shifted)


async def test_what_cannot_be_transformed_is_said(window: Make, recorded: Recorded) -> None:
    scan = window("/scan", "sensor_msgs/msg/LaserScan", [(2.0, {"header": {"frame_id": "laser"}})])
    with pytest.raises(BadInput, match="nothing to transform"):
        await tf_lookup(Recorded([*windows(window), scan]), request(field="/scan"))
    with pytest.raises(BadInput, match="Give source"):
        await tf_lookup(recorded, request(frame=""))


async def test_a_message_that_cannot_be_decoded_is_skipped_counted_and_told(window: Make) -> None:
    both = windows(window)
    broken = Sample(START_NS + SECOND, 0, None, b"\x00\x01\x00\x00\xff\xff\xff\x7f")
    damaged = replace(both[0], samples=[*both[0].samples, broken])
    found = await tf_lookup(Recorded([damaged, both[1]]), request())
    assert "1 message that cannot be decoded" in found.note
    assert found.translation.x == pytest.approx(14.5)


URDF = """<robot name="r"><link name="base_link"/><link name="wheel"/><link name="sonar"/>
<joint name="axle" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
<joint name="screw" type="fixed"><parent link="base_link"/><child link="sonar"/></joint></robot>"""


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        ("wheel", "by the joint axle, which moves: a state publisher publishes it once /joint_states has"),
        ("sonar", "by the joint screw, which is fixed: no state publisher publishes it on /tf_static"),
        ("axle", "axle is a joint of the description; its link is wheel"),
    ],
)
async def test_of_a_frame_that_no_transform_names_the_description_is_asked(window: Make, frame: str, said: str) -> None:
    described = window("/robot_description", "std_msgs/msg/String", [(0.0, {"data": URDF})])
    with pytest.raises(NoTransform, match=f"There is no frame {frame} in TF.*{said}"):
        await tf_lookup(Recorded([*windows(window), described]), request(frame=frame))


async def test_what_has_no_stamp_is_told_with_its_age_and_rate_and_is_not_called_static(window: Make) -> None:
    told = [(n / 10, {"transforms": [tf("odom", "base_link", 1.0, 0.0)]}) for n in range(21)]
    for _, message in told:
        message["transforms"][0]["header"]["stamp"] = {"sec": 0, "nanosec": 0}
    found = await tf_lookup(Recorded([window("/tf", TF, told)]), request("odom", "base_link"))
    assert not found.is_static and found.age_s is not None and found.edges[0].rate_hz == pytest.approx(10.0)
    assert "without a stamp" in found.summary()[0] and "has no stamp" in found.note


async def test_a_pause_around_the_time_that_is_asked_for_is_told(window: Make) -> None:
    told = [(at_s, {"transforms": [tf("odom", "base_link", at_s, 0.0, at_s=at_s)]}) for at_s in (0.0, 0.1, 5.1, 5.2)]
    found = await tf_lookup(
        Recorded([window("/tf", TF, told)]), request("odom", "base_link", time=f"{START_NS / 1e9 + 3:.3f}")
    )
    assert "odom → base_link was not published for 5 s around that time, from 2023" in found.note
    assert "the nearest transforms are 2.9 s before and 2.1 s after it, and this pose is interpolated" in found.note
    assert found.age_s is None and found.edges[0].age_s == pytest.approx(2.9)
    assert "0 ms old" not in " ".join(found.summary())


@pytest.mark.parametrize(
    ("edge", "jumps", "said"),
    [
        (("odom", "base_link"), 1, "odom → base_link jumped by 5 m and 0° within 0.1 s, 1 s ago (odometry was reset,"),
        (("map", "odom"), 1, ""),
        (("map", "odom"), 2, ", 0.5 s ago, the last of 2 such jumps, the first 1 s ago (the"),
    ],
)
async def test_a_jump_of_the_place_is_told_of_a_localisation_only_where_it_jumps_again(
    window: Make, edge: tuple[str, str], jumps: int, said: str
) -> None:
    told = [
        (n / 10, {"transforms": [tf(*edge, 5.0 * ((n >= 20) - (n >= 25) * (jumps - 1)), 0.0, at_s=n / 10)]})
        for n in range(31)
    ]
    found = await tf_lookup(Recorded([window("/tf", TF, told)]), request(*edge))
    assert said in found.note if said else not found.note


async def test_what_moves_and_is_told_too_rarely_is_said_with_its_rate(window: Make) -> None:
    told = [(n * 3.0, {"transforms": [tf("map", "odom", 0.0, 0.0, at_s=n * 3.0)]}) for n in range(4)]
    found = await tf_lookup(Recorded([window("/tf", TF, told)]), request("map", "odom"))
    assert "map → odom is published too rarely for a moving frame, every 3 s (0.33 Hz)" in found.note


async def test_a_name_with_a_leading_slash_is_answered_but_tf2_would_refuse_it(recorded: Recorded) -> None:
    found = await tf_lookup(recorded, request("odom", "/base_link"))
    assert found.source == "base_link"
    assert "tf2 rejects names with a leading slash, such as «/base_link»" in found.note
    assert "slash" not in (await tf_lookup(recorded, request("odom", "base_link"))).note
