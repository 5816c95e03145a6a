"""What a small motion says of lidar, odometry and wheels, on measurements made for it."""

from __future__ import annotations

import math
from dataclasses import replace

from ros2_mcp.ops.navigation.checks.probed import CHECK
from ros2_mcp.ops.navigation.evidence import Motion, NavEvidence, NavFinding, Probe
from ros2_mcp.ops.sources.source import GraphSnapshot


def turn(odometry: float, gyro: float | None = None, laser: float | None = None, commanded: float = 30.0) -> Probe:
    """A turn in degrees, as each witness tells it."""

    def motion(degrees: float) -> Motion:
        return Motion(0.0, 0.0, math.radians(degrees))

    return Probe(
        is_turn=True,
        commanded=math.radians(commanded),
        odometry={"/odom": motion(odometry), "/wheel/odom": motion(odometry)},
        laser={} if laser is None else {"/scan": motion(laser)},
        gyro={} if gyro is None else {"/imu": math.radians(gyro)},
    )


def drive(odometry: float, away: float, way_deg: float = 0.0, commanded: float = 0.2) -> Probe:
    """A drive in m, with the way in which the scan went."""
    way = math.radians(way_deg)
    seen = Motion(away * math.cos(way), away * math.sin(way), 0.0)
    return Probe(
        is_turn=False, commanded=commanded, odometry={"/odom": Motion(odometry, 0, 0)}, laser={"/scan": seen}, gyro={}
    )


def found(*probes: Probe) -> list[NavFinding]:
    return list(CHECK.find(NavEvidence(graph=GraphSnapshot({}, ()), probes=probes)))


def only(*probes: Probe) -> NavFinding:
    (finding,) = found(*probes)
    return finding


def test_a_motion_as_commanded_is_fine_with_slip_and_noise() -> None:
    assert found(drive(0.2, 0.17, 8), turn(30, 28, 31)) == []
    assert found(turn(30, 29)) == []
    assert found(turn(30)) == [] and found(drive(0.01, 0.012, 170), turn(1, -1, 2)) == []


def test_a_lidar_that_is_turned_is_named_with_the_angle_that_its_transform_lacks() -> None:
    finding = only(drive(0.2, 0.2, 178), turn(30, 30, 30))
    assert finding.subject == "/scan" and "turned against its transform by 178°" in finding.cause
    assert "Add -178° to the yaw" in finding.remedy and "/odom +0.20 m" in finding.proof
    assert "Add 40° to the yaw" in only(drive(0.2, 0.2, -40), turn(30, 30, 30)).remedy


def test_odometry_that_turns_the_wrong_way_is_told_from_wheels_that_are_exchanged() -> None:
    assert "Odometry turns the wrong way: /odom, /wheel/odom" in only(turn(-30, 30, 30)).cause
    assert "against its commands, and odometry does not see it" in only(turn(30, -30, -30)).cause
    seen = only(turn(-30, -30, -30)).cause
    assert "turns against its commands" in seen and "does not see" not in seen
    assert "Odometry turns the wrong way" in only(turn(-30, None, 31)).cause


def test_of_odometries_that_contradict_each_other_the_wrong_one_is_named_and_its_drive_is_not_judged() -> None:
    both = turn(-30, 30, 30)
    several = replace(both, odometry={**both.odometry, "/wheel/odom_raw": Motion(0.0, 0.0, math.radians(30))})
    assert "Odometry turns the wrong way: /odom, /wheel/odom." in only(several).cause
    assert "turns the wrong way" in only(drive(-0.2, 0.2), several).cause


def test_only_the_odometries_that_miscount_are_named_with_their_own_share() -> None:
    half = drive(0.1, 0.2)
    finding = only(replace(half, odometry={**half.odometry, "/wheel/odom_raw": Motion(0.2, 0, 0)}))
    assert "Odometry counts 0.50 of what the robot drives: /odom." in finding.cause


def test_motors_whose_signs_are_wrong_are_no_turned_lidar() -> None:
    causes = [one.cause for one in found(drive(0.2, 0.2, 179), turn(30, -30, -30))]
    assert len(causes) == 2 and not any("lidar" in cause for cause in causes)
    assert "drives against its commands, and odometry does not see it" in causes[0]
    assert "drives against its commands: " in only(drive(-0.2, 0.2, 180)).cause
    assert "Odometry counts backwards" in only(drive(-0.2, 0.2, 2)).cause


def test_a_gyro_and_a_scan_that_are_upside_down_are_named_by_what_the_others_say() -> None:
    assert "The scan turns the wrong way (/scan)" in only(turn(30, 30, -30)).cause
    assert "The gyro turns the wrong way (/imu)" in only(turn(30, -30, 30)).cause


def test_a_scale_that_is_wrong_is_told_as_a_share_and_a_small_one_is_not() -> None:
    half = only(drive(0.2, 0.4))
    assert "counts 0.50 of what the robot drives" in half.cause and half.rank == "stops some goals"
    assert "counts 2.00 of what the robot turns" in only(turn(30, 15, 15)).cause
    assert found(drive(0.2, 0.24), turn(30, 25, 25)) == []


def test_wheels_that_slip_and_encoders_that_count_nothing_are_told() -> None:
    assert "motion that nothing else sees" in only(drive(0.2, 0.01)).cause
    assert "no motion while the robot moves" in only(turn(0, 30, 30)).cause
