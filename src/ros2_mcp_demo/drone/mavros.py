"""/mavros/mavros: the autopilot's MAVROS topics and services, as far as a flight needs them.

Names, types and QoS are those of MAVROS 2; there many nodes share them, here one node has all.
"""

# pyright: basic, reportMissingImports=false
from __future__ import annotations

import math

from geographic_msgs.msg import GeoPoint
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from mavros_msgs.msg import ExtendedState, HomePosition, State, StatusText, Waypoint, WaypointList
from mavros_msgs.srv import CommandBool, CommandLong, CommandTOL, SetMode, WaypointPush
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import Float64

from ..nodes.part import RobotPart
from . import mission as plans
from .attitude import attitude
from .autopilot import ACCEPTED, CRITICAL, WARNING

HEARTBEAT_HZ, POSITION_HZ, BATTERY_HZ = 1.0, 10.0, 1.0
STANDING_BY, ACTIVE = 3, 4
"""MAV_STATE of MAVLink."""
_LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The QoS with which MAVROS publishes its states."""


class Mavros(RobotPart):
    """MAVROS with the simulated autopilot."""

    def __init__(self, robot, namespace):
        super().__init__("mavros", robot, f"{namespace}/mavros")
        self._frame_prefix = namespace.strip("/")
        self._pilot = robot.autopilot
        self._said, self._mission = None, None
        sensor = qos_profile_sensor_data
        self._state = self.create_publisher(State, "state", _LATCHED)
        self._extended = self.create_publisher(ExtendedState, "extended_state", _LATCHED)
        self._texts = self.create_publisher(StatusText, "statustext/recv", sensor)
        self._battery = self.create_publisher(BatteryState, "battery", sensor)
        self._global = self.create_publisher(NavSatFix, "global_position/global", sensor)
        self._altitude = self.create_publisher(Float64, "global_position/rel_alt", sensor)
        self._heading = self.create_publisher(Float64, "global_position/compass_hdg", sensor)
        self._pose = self.create_publisher(PoseStamped, "local_position/pose", sensor)
        self._home = self.create_latched_publisher(HomePosition, "home_position/home")
        self._waypoints = self.create_latched_publisher(WaypointList, "mission/waypoints")
        self.create_service(SetMode, "set_mode", self._set_mode)
        self.create_service(CommandBool, "cmd/arming", self._arm)
        self.create_service(CommandTOL, "cmd/takeoff", self._take_off)
        self.create_service(CommandTOL, "cmd/land", self._land)
        self.create_service(CommandLong, "cmd/command", self._command)
        self.create_service(WaypointPush, "mission/push", self._push)
        self.create_subscription(TwistStamped, "setpoint_velocity/cmd_vel", self._move_stamped, sensor)
        self.create_subscription(Twist, "setpoint_velocity/cmd_vel_unstamped", self._move, sensor)
        self.create_subscription(PoseStamped, "setpoint_position/local", self._go, sensor)
        self._is_new = True

    def tick(self, stamp):
        """Publish what is due, and states as soon as they change."""
        if self._is_new:
            self._is_new = False
            self._publish_home(stamp)
        self._tell(stamp)
        if self.is_due(POSITION_HZ, "position"):
            self._publish_position(stamp)
        if self.is_due(BATTERY_HZ, "battery"):
            self._publish_battery(stamp)
        plan = (self._pilot.current, self._pilot.items)
        if plan != self._mission:
            self._mission = plan
            self._waypoints.publish(WaypointList(current_seq=plan[0], waypoints=[_waypoint(each) for each in plan[1]]))
        said = (self._pilot.mode, self._pilot.armed, self._pilot.landed_state)
        if said != self._said or self.is_due(HEARTBEAT_HZ, "state"):
            self._said = said
            self._publish_state(stamp)

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _tell(self, stamp):
        while self._pilot.texts:
            severity, text = self._pilot.texts.popleft()
            self._texts.publish(self.headed(StatusText(severity=severity, text=text), stamp, ""))
            log = self.get_logger()
            if severity <= CRITICAL:
                log.error(f"FCU: {text}")
            elif severity <= WARNING:
                log.warning(f"FCU: {text}")
            else:
                log.info(f"FCU: {text}")

    def _publish_state(self, stamp):
        pilot = self._pilot
        state = State(connected=True, armed=pilot.armed, guided=pilot.mode in ("GUIDED", "AUTO"), mode=pilot.mode)
        state.manual_input, state.system_status = pilot.mode == "STABILIZE", ACTIVE if pilot.armed else STANDING_BY
        self._state.publish(self.headed(state, stamp, ""))
        extended = ExtendedState(vtol_state=ExtendedState.VTOL_STATE_UNDEFINED, landed_state=pilot.landed_state)
        self._extended.publish(self.headed(extended, stamp, ""))

    def _publish_home(self, stamp):
        home = HomePosition(geo=GeoPoint(latitude=plans.HOME_LATITUDE, longitude=plans.HOME_LONGITUDE))
        home.geo.altitude = plans.HOME_ALTITUDE
        self._home.publish(self.headed(home, stamp, "map"))

    def _publish_position(self, stamp):
        x, y, z = map(float, self.robot.localize())
        latitude, longitude = plans.degrees(x, y)
        fix = NavSatFix(latitude=latitude, longitude=longitude, altitude=plans.HOME_ALTITUDE + z)
        self._global.publish(self.headed(fix, stamp, "gps_link"))
        self._altitude.publish(Float64(data=z))
        self._heading.publish(Float64(data=(90.0 - math.degrees(self.robot.frame.yaw)) % 360.0))
        pose = self.headed(PoseStamped(), stamp, "map")
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x, y, z
        pose.pose.orientation = attitude(self.robot.frame)
        self._pose.publish(pose)

    def _publish_battery(self, stamp):
        battery = self.robot.frame.battery
        message = BatteryState(voltage=battery.voltage, current=-battery.current, percentage=battery.charge)
        message.present, message.power_supply_status = True, BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
        self._battery.publish(self.headed(message, stamp, ""))

    # ── orders ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _set_mode(self, request, response):
        response.mode_sent = self._pilot.knows_mode(request.custom_mode)
        if response.mode_sent:
            self._pilot.set_mode(request.custom_mode)  # MAVROS does not wait for the outcome
        else:
            self.get_logger().error(f"MODE: Unknown mode: {request.custom_mode}")
        return response

    def _arm(self, request, response):
        return _answered(response, self._pilot.arm(request.value))

    def _take_off(self, request, response):
        return _answered(response, self._pilot.take_off(request.altitude))

    def _land(self, _, response):
        return _answered(response, self._pilot.command(plans.LAND, [0.0] * 7))

    def _command(self, request, response):
        numbers = [getattr(request, f"param{number}") for number in range(1, 8)]
        return _answered(response, self._pilot.command(request.command, numbers))

    def _push(self, request, response):
        try:
            items = [_item(number, each) for number, each in enumerate(request.waypoints)]
            if request.start_index:
                raise ValueError("a part of a mission is not taken")
            if len(items) > plans.MOST_ITEMS:
                raise ValueError(f"more than {plans.MOST_ITEMS} items")
        except ValueError as error:
            self._pilot.say(f"Mission: {error}", WARNING)
        else:
            response.success = self._pilot.push(items) is None
            response.wp_transfered = len(items) if response.success else 0
        return response

    def _move_stamped(self, message):
        self._move(message.twist)

    def _move(self, twist):
        velocity = (twist.linear.x, twist.linear.y, twist.linear.z)
        if all(map(math.isfinite, (*velocity, twist.angular.z))) and not self._pilot.move(velocity, twist.angular.z):
            self._ignored("a velocity")

    def _go(self, target):
        place, turn = target.pose.position, target.pose.orientation
        heading = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))
        numbers = (place.x, place.y, place.z, heading)
        if all(map(math.isfinite, numbers)) and not self._pilot.go(numbers[:3], heading):
            self._ignored("a place")

    def _ignored(self, what):
        why = "it is not flying in GUIDED, or the place is above the ceiling"
        self.get_logger().warning(f"{what} was ignored: {why}", throttle_duration_sec=5.0)


def _answered(response, result):
    response.success, response.result = result == ACCEPTED, result
    return response


def _item(number, waypoint):
    """Convert a waypoint to a mission item; raises `ValueError` with the reason."""
    parameters = (waypoint.param1, waypoint.param2, waypoint.param3, waypoint.param4)
    place = (waypoint.x_lat, waypoint.y_long, waypoint.z_alt)
    try:
        return plans.item_of(waypoint.command, waypoint.frame, parameters, *place)
    except ValueError as error:
        raise ValueError(f"item {number}: {error}") from error


def _waypoint(item):
    latitude, longitude = (0.0, 0.0) if math.isnan(item.x) else plans.degrees(item.x, item.y)
    first, second, third, fourth = map(float, item.parameters)
    return Waypoint(
        frame=Waypoint.FRAME_GLOBAL_REL_ALT,
        command=item.command,
        autocontinue=True,
        param1=first,
        param2=second,
        param3=third,
        param4=fourth,
        x_lat=latitude,
        y_long=longitude,
        z_alt=float(item.z),
    )
