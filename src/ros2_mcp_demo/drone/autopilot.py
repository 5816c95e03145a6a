"""The simulated autopilot: modes, arming, missions and refusals, modelled on ArduCopter. Pure Python, no ROS.

Orders have the effects that ArduCopter documents, as far as a flight through MAVROS needs them; where ArduCopter only
refuses, this autopilot also says why.
"""

# pyright: basic
from __future__ import annotations

import math
from collections import deque

import numpy as np

from . import mission as plans
from .control import BRAKING, Control
from .mission import Item

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
"""MAV_RESULT of MAVLink."""
CRITICAL, WARNING, INFO = 2, 4, 6
"""MAV_SEVERITY of MAVLink."""
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""MAV_LANDED_STATE of MAVLink."""
MODES = {
    "STABILIZE": 0,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "LAND": 9,
    "POSHOLD": 16,
    "BRAKE": 17,
}
"""The supported modes of ArduCopter, with their numbers."""
_NOT_ARMABLE = ("AUTO", "RTL", "LAND", "BRAKE")
_HOLDING = ("ALT_HOLD", "LOITER", "POSHOLD", "BRAKE", "GUIDED")
_FORCE = 21196.0
"""Second parameter of an arm or disarm command that skips all checks."""

IDLE_DISARM_S = 10.0
"""Time until the motors are disarmed when armed on the ground without a take-off (DISARM_DELAY)."""
LANDED_S = 1.0
SETPOINT_S = 3.0
"""Time until a velocity set point expires (GUID_TIMEOUT)."""
TELEOP_S = 1.0
RTL_ALTITUDE, RTL_SLOPE = 15.0, 3.0
"""Height above home of the return flight in m, and the slope of the climb when it is near home."""
LAND_FAST, LAND_SLOW, LAND_SLOW_BELOW = 1.5, 0.5, 5.0
REACHED_M, TAKEN_OFF_M = 1.0, 0.3
MOST_TEXTS = 50
LOW_BATTERY = 0.15


class Autopilot:
    """The autopilot: orders are methods, and `step` flies. Its state: `mode`, `armed`, `current` (mission item).

    `texts` are pending status texts as (severity, text); `reached` is the last item that was reached. `fence_altitude`
    is the ceiling in m above home.
    """

    def __init__(self, frame):
        self.frame = frame
        self.mode, self.armed = "STABILIZE", False
        self.items: list[Item] = []
        self.current = 0
        self.reached = -1
        self.fence_altitude = 100.0
        self.texts = deque(maxlen=MOST_TEXTS)
        self._control = Control()
        self._hold = np.zeros(3)
        self._heading = frame.yaw
        self._velocity, self._turning, self._velocity_for_s = np.zeros(3), 0.0, 0.0
        self._taking_off_to = 0.0
        self._on_ground_s = self._at_item_s = 0.0
        self._is_started = self._is_landing = self._has_warned = self._has_braked = False

    # ── what it tells ──────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def altitude(self):
        """The height above home in m."""
        return float(self.frame.position[2])

    @property
    def landed_state(self):
        """The MAV_LANDED_STATE of EXTENDED_SYS_STATE."""
        if self.frame.is_on_ground:
            return ON_GROUND
        if self._taking_off_to:
            return TAKING_OFF
        return LANDING if self._is_landing else IN_AIR

    def say(self, text, severity=INFO):
        """Queue a status text. STATUSTEXT holds 50 characters per piece; ours are not split."""
        self.texts.append((severity, text))

    # ── orders ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def knows_mode(self, mode):
        """Whether a mode of this name exists."""
        return mode in MODES

    def set_mode(self, mode):
        """Change the mode; return whether that succeeded. A status text says why not."""
        reason = self._mode_problem(mode)
        if reason:
            self.say(f"Mode change to {mode} failed: {reason}", WARNING)
            return False
        if mode == self.mode:
            return True
        self.mode = mode
        self._taking_off_to, self._is_landing, self._is_started = 0.0, mode == "LAND", False
        self._begin_holding()
        if mode == "AUTO" and not self.frame.is_on_ground:
            self._start_mission()
        return True

    def arm(self, value, force=False):
        """Arm or disarm; return a MAV_RESULT."""
        if value == self.armed:
            return ACCEPTED
        if not value:
            if not (self.frame.is_on_ground or force):
                self.say("Disarm: it flies; land first", WARNING)
                return FAILED
            self._disarm("Disarming motors")
            return ACCEPTED
        if self.mode in _NOT_ARMABLE and not force:
            self.say(f"Arm: {self.mode} mode not armable", CRITICAL)
            return FAILED
        if self.frame.battery.charge < LOW_BATTERY and not force:
            self.say("Arm: Battery below minimum arming level", CRITICAL)
            return FAILED
        self.armed = self.frame.motors_run = True
        self._on_ground_s, self._heading = 0.0, self.frame.yaw
        self._control.forget_wind()
        self._begin_holding()
        self.say("Arming motors")
        return ACCEPTED

    def take_off(self, altitude):
        """Take off to a height in m above home, in GUIDED; return a MAV_RESULT."""
        if self.mode != "GUIDED":
            problem = f"the mode is {self.mode}, not GUIDED"
        elif not self.armed:
            problem = "the motors are not armed"
        elif not self.frame.is_on_ground:
            problem = "it flies already"
        else:
            problem = self._height_problem(altitude)
        if problem:
            self.say(f"Takeoff: {problem}", WARNING)
            return FAILED
        self._taking_off_to = altitude
        self._hold = np.array([*self.frame.position[:2], altitude])
        return ACCEPTED

    def command(self, number, parameters):
        """Execute a MAVLink command with its seven parameters; return a MAV_RESULT."""
        if number == plans.TAKEOFF:
            return self.take_off(parameters[6])
        if number == plans.ARM_DISARM:
            return self.arm(parameters[0] > 0.5, parameters[1] == _FORCE)
        if number in (plans.LAND, plans.RETURN):
            return ACCEPTED if self.set_mode("LAND" if number == plans.LAND else "RTL") else FAILED
        if number == plans.SET_MODE:
            mode = next((name for name, code in MODES.items() if code == parameters[1]), "")
            return ACCEPTED if mode and self.set_mode(mode) else FAILED
        if number == plans.START_MISSION:
            return self._command_mission()
        if number == plans.CHANGE_SPEED and 0 < parameters[1] <= 20:
            self._control.speed = parameters[1]
            return ACCEPTED
        self.say(f"Command {number} is not supported", WARNING)
        return UNSUPPORTED

    def push(self, items):
        """Replace the mission; return None, or why it was refused."""
        for number, item in enumerate(items):
            if item.command in (plans.WAYPOINT, plans.TAKEOFF) and number and (why := self._height_problem(item.z)):
                self.say(f"Mission: item {number}: {why}", WARNING)
                return f"item {number}: {why}"
        self.items, self.current, self.reached = list(items), 0, -1
        self._is_started = False
        self.say(f"Mission: {len(self.items)} items received")
        return None

    def move(self, velocity, turning):
        """Set a velocity (3,) in m/s and a yaw rate in rad/s; return whether it is followed."""
        if not self._is_guided():
            return False
        self._velocity, self._turning, self._velocity_for_s = np.asarray(velocity, dtype=float), turning, SETPOINT_S
        return True

    def go(self, place, heading):
        """Set a position (3,) in m and a heading in rad; return whether it is followed."""
        if not self._is_guided() or self._height_problem(place[2]):
            return False
        self._hold, self._heading, self._velocity_for_s = np.asarray(place, dtype=float), heading, 0.0
        return True

    def fly_by_hand(self, velocity, turning):
        """Follow the quadcopter's own velocity input, which needs no arming: it takes off on a climbing velocity."""
        if not self.armed and velocity[2] > 0.05:
            self.mode = "GUIDED"
            self.arm(True, force=True)
        if self.armed:
            self.mode, self._taking_off_to, self._is_landing = "GUIDED", 0.0, False
            self._velocity, self._turning, self._velocity_for_s = np.asarray(velocity, dtype=float), turning, TELEOP_S

    # ── flying ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def step(self, dt):
        """Fly for `dt` s."""
        self.frame.step(self._wanted(dt), self._yaw_rate(dt), dt)
        if not self.armed:
            return
        self._watch_battery()
        self._watch_ground(dt)
        if self.mode == "AUTO" and self._is_started:
            self._follow_mission(dt)

    def _wanted(self, dt):
        """Return the wanted acceleration (3,) in m/s² now."""
        frame, control = self.frame, self._control
        if not self.armed:
            return np.zeros(3)
        if frame.is_on_ground and not self._is_leaving_ground():
            control.reset()
            return np.array([0.0, 0.0, -2.0])
        if self.mode == "STABILIZE":  # no pilot: the throttle is at its lowest
            return control.to_velocity(frame, np.array([0.0, 0.0, -3.0]), dt)
        if self._velocity_for_s > 0:
            self._velocity_for_s -= dt
            velocity = np.array(self._velocity)
            if self.altitude >= self.fence_altitude:
                velocity[2] = min(velocity[2], 0.0)
            if self._velocity_for_s <= 0:
                self._begin_holding()
            return control.to_velocity(frame, velocity, dt)
        if self._is_landing:
            return self._descend(dt)
        if self.mode == "RTL":
            return self._return(dt)
        if self.mode == "BRAKE" and float(np.linalg.norm(frame.velocity)) > 0.15 and not self._is_braked():
            self._hold = np.array(frame.position)
            return control.to_velocity(frame, np.zeros(3), dt, BRAKING)
        return control.to_place(frame, self._hold, dt)

    def _is_braked(self):
        """Whether the drone has come to rest in this BRAKE; from then on it holds its position against the wind."""
        if float(np.linalg.norm(self.frame.velocity)) <= 0.3:
            self._has_braked = True
        return self._has_braked

    def _yaw_rate(self, dt):  # noqa: ARG002 - as `_wanted`
        if self._velocity_for_s > 0:
            return self._turning
        return self._control.turning(self.frame, self._heading)

    def _is_leaving_ground(self):
        return bool(self._taking_off_to) or (self._velocity_for_s > 0 and self._velocity[2] > 0)

    def _begin_holding(self):
        """Hold the position at which the drone will come to rest."""
        frame = self.frame
        speed = math.hypot(frame.velocity[0], frame.velocity[1])
        ahead = frame.velocity * (speed / (2 * 2.5)) if speed > 0.2 else np.zeros(3)
        self._hold = frame.position + np.array([ahead[0], ahead[1], 0.0])
        self._velocity_for_s, self._has_braked, self._heading = 0.0, False, frame.yaw
        self._control.reset(frame.velocity)

    def _descend(self, dt):
        speed = LAND_FAST if self.altitude > LAND_SLOW_BELOW else LAND_SLOW
        place = np.array([self._hold[0], self._hold[1], self.altitude - 10.0])
        return self._control.to_place(self.frame, place, dt, descent=speed)

    def _return(self, dt):
        """Climb, fly home, and land."""
        distance = math.hypot(*self.frame.position[:2])
        if not self._is_started:
            self._is_started = True
            self._hold = np.array(self.frame.position)
            self._hold[2] = max(self.altitude, min(RTL_ALTITUDE, RTL_SLOPE * distance))
        if self.altitude > self._hold[2] - TAKEN_OFF_M or distance < REACHED_M:
            self._hold[:2] = 0.0
        if distance < REACHED_M / 2:
            self._is_landing, self._hold = True, np.zeros(3)
        return self._control.to_place(self.frame, self._hold, dt)

    def _watch_ground(self, dt):
        frame = self.frame
        if self._taking_off_to and self.altitude > self._taking_off_to - TAKEN_OFF_M:
            self._taking_off_to = 0.0
        rests = frame.is_on_ground and not self._is_leaving_ground()
        self._on_ground_s = self._on_ground_s + dt if rests else 0.0
        is_flown_down = self._velocity_for_s > 0 and self._velocity[2] < 0
        has_landed = self._is_landing or self.mode == "STABILIZE" or is_flown_down
        if self._on_ground_s > (LANDED_S if has_landed and frame.fell_at else IDLE_DISARM_S):
            if frame.fell_at > 2.5:
                self.say(f"Crash: hit the ground at {frame.fell_at:.1f} m/s", CRITICAL)
            self._disarm("Landed: disarming motors" if frame.fell_at else "Disarming motors: no take-off came")

    def _watch_battery(self):
        if self.frame.battery.charge < LOW_BATTERY and not self._has_warned and not self.frame.is_on_ground:
            self._has_warned = True
            self.say("Battery failsafe: returning to launch", CRITICAL)
            self.set_mode("RTL")

    def _disarm(self, text):
        self.armed = self.frame.motors_run = False
        self._taking_off_to, self._is_landing, self._is_started, self._velocity_for_s = 0.0, False, False, 0.0
        self.frame.fell_at, self._on_ground_s = 0.0, 0.0
        self.say(text)

    # ── missions ───────────────────────────────────────────────────────────────────────────────────────────────────

    def _command_mission(self):
        if not self.armed:
            self.say("Mission: not started, the motors are not armed", WARNING)
            return FAILED
        if not self.set_mode("AUTO"):
            return FAILED
        self._start_mission()
        return ACCEPTED

    def _start_mission(self):
        if not self._is_started:
            self._is_started = True
            self._begin_item(1)

    def _begin_item(self, number):
        """Begin a mission item; after the last one hold the position, or stay on the ground."""
        if number >= len(self.items):
            self._is_started = False
            self._begin_holding()
            return
        self.current, self._at_item_s = number, 0.0
        item, frame = self.items[number], self.frame
        x, y = (frame.position[0], frame.position[1]) if math.isnan(item.x) else (item.x, item.y)
        self._is_landing = False
        if item.command == plans.TAKEOFF:
            self._taking_off_to = item.z
            self._hold = np.array([frame.position[0], frame.position[1], item.z])
        elif item.command == plans.LAND:
            self._hold = np.array([x, y, max(self.altitude, 0.0)])
        elif item.command == plans.CHANGE_SPEED:
            self._control.speed = min(max(item.parameters[1], 0.5), 20.0)
        elif item.command == plans.RETURN:
            self._hold = np.array([0.0, 0.0, max(self.altitude, 2.0)])
        else:
            self._hold = np.array([x, y, item.z])
        if math.dist(self._hold[:2], frame.position[:2]) > REACHED_M:
            self._heading = math.atan2(self._hold[1] - frame.position[1], self._hold[0] - frame.position[0])
        self.say(f"Mission: {number} {_NAMES.get(item.command, item.command)}")

    def _follow_mission(self, dt):
        item = self.items[self.current]
        if item.command == plans.CHANGE_SPEED:
            self._reach()
        elif item.command == plans.TAKEOFF:
            if self.altitude > item.z - TAKEN_OFF_M:
                self._reach()
        elif math.dist(self._hold, self.frame.position) < REACHED_M and not self._is_landing:
            self._at_item_s += dt
            self._arrive(item)

    def _arrive(self, item):
        if item.command in (plans.LAND, plans.RETURN):
            self._is_landing = True
            self.reached = self.current
        elif item.command == plans.LOITER_UNLIMITED:
            self.reached = self.current
        elif self._at_item_s >= item.parameters[0]:  # the time to stay in s, of a waypoint and of LOITER_TIME
            self._reach()

    def _reach(self):
        self.reached = self.current
        self._begin_item(self.current + 1)

    # ── refusing ───────────────────────────────────────────────────────────────────────────────────────────────────

    def _is_guided(self):
        return self.armed and self.mode == "GUIDED" and not self._taking_off_to and not self.frame.is_on_ground

    def _height_problem(self, altitude):
        if not math.isfinite(altitude) or altitude <= 0:
            return f"a height of {altitude:g} m above home is not one to fly at"
        if altitude > self.fence_altitude:
            return f"{altitude:g} m is above the ceiling of {self.fence_altitude:g} m (FENCE_ALT_MAX)"
        return ""

    def _mode_problem(self, mode):
        if mode == "AUTO":
            if len(self.items) < 2:
                return "there is no mission"
            if self.armed and self.frame.is_on_ground and self.items[1].command != plans.TAKEOFF:
                return "Missing Takeoff Cmd"
        if mode == "RTL" and not self.armed:
            return "the motors are not armed"
        return ""


_NAMES = {
    plans.WAYPOINT: "Waypoint",
    plans.LOITER_UNLIMITED: "Loiter",
    plans.LOITER_TIME: "Loiter",
    plans.RETURN: "RTL",
    plans.LAND: "Land",
    plans.TAKEOFF: "Takeoff",
    plans.CHANGE_SPEED: "Speed",
}
