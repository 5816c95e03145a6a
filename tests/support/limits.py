"""A policy as the bridge gets it, and a judge of what arrives that knows nothing of ours: it unpacks the bytes."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from ros2_mcp_bridge.exit import limiter
from ros2_mcp_common.policy.checks import Checks
from ros2_mcp_common.policy.rules import Allowance, Forbidden, Limit, Ramp, Rules, RuleSet
from support.velocities import STAMPED, TWIST, TWIST_STAMPED

LINEAR, ANGULAR = 0.4, 0.8
"""The most that the policy lets out, in m/s and rad/s."""
UP, DOWN, TURN = 0.5, 2.0, 1.5
"""Its ramps, in m/s² and rad/s²."""
STEP_S = 0.1
"""A step of a ramp is reckoned with no more time than this."""
HOLD_S, RATE_HZ = 0.5, 100.0
SET_BOOL, TRIGGER = "std_srvs/srv/SetBool", "std_srvs/srv/Trigger"
ROUNDING = 1 + 1e-6


def rules(*, ramp: bool = True, rate_hz: float | None = RATE_HZ, hold_s: float | None = HOLD_S, **more: float) -> Rules:
    """Velocities on `cmd_vel` in any namespace, by every way of publishing; one service, with True alone."""
    types = TWIST, TWIST_STAMPED
    limit = Limit(
        rule="limits.base",
        types=types,
        checks=Checks(
            norm={"linear": LINEAR, "angular": ANGULAR}, zero=("linear.y", "linear.z", "angular.x", "angular.y")
        ),
        ramp={"linear": Ramp(UP, DOWN), "angular": Ramp(TURN, TURN)} if ramp else {},
        hold_s=hold_s,
    )
    names = ("/**/cmd_vel",)
    allowed = (
        Allowance("allow[0]", "publish", names, types, rate_hz=rate_hz, **more),
        Allowance("allow[1]", "relay", names, types, for_s=more.get("for_s"), sources=("/**",)),
        Allowance("allow[2]", "play", names, types),
        Allowance("allow[3]", "call", ("/lamp",), (SET_BOOL,), Checks(one_of={"data": (True,)}), **more),
    )
    forbidden = (Forbidden("forbid[0]", names=("/base/cmd_vel",)),)
    return Rules("d1ge57", (RuleSet("test", allowed, forbidden, (limit,)),))


def body(rules: Rules) -> bytes:
    """As they go down."""
    return json.dumps(rules.as_json()).encode()


def vectors(kind: str, data: bytes) -> tuple[list[float], list[float]]:
    """Linear and angular velocity in the CDR of a Twist or TwistStamped, taken apart by hand."""
    order = "<" if data[1] & 1 else ">"
    at = 4
    if kind in STAMPED:
        (size,) = struct.unpack_from(f"{order}I", data, 12)
        at = 16 + size
        at += -(at - 4) % 8
    assert len(data) - at in range(48, 52), "something rides behind"
    numbers = struct.unpack_from(f"{order}6d", data, at)
    return list(numbers[:3]), list(numbers[3:])


def over(linear: list[float], angular: list[float]) -> str:
    """What of a velocity is over the limits of `rules`; empty if nothing is. NaN is."""
    if not math.hypot(*linear) <= LINEAR * ROUNDING:
        return f"linear {linear}"
    if not math.hypot(*angular) <= ANGULAR * ROUNDING:
        return f"angular {angular}"
    if any((*linear[1:], *angular[:2])):
        return f"an axis that has to be zero: {linear} {angular}"
    return ""


def steepness(before: list[float], after: list[float], seconds: float, up: float, down: float) -> float:
    """By how much a step is steeper than its ramp: 1.0 is as steep as allowed. A zero is always allowed."""
    if not any(after):
        return 0.0
    most = (up if math.hypot(*after) > math.hypot(*before) else down) * min(seconds, STEP_S)
    length = math.dist(before, after)
    return length / most if most else math.inf if length else 0.0


class Middleware:
    """Where a publisher of the bridge hands its bytes to, in steps: it keeps what came and when."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.came: list[tuple[float, bytes]] = []
        self._now = now

    def publish_raw(self, data: bytes) -> None:
        self.came.append((self._now(), data))

    def get_subscription_count(self) -> int:
        return 1

    def destroy_when_not_in_use(self) -> None:
        """Nothing to do."""


@contextmanager
def without_limiter() -> Iterator[None]:
    """The bridge as it would be without a limiter: tests show with it that they would notice."""

    everything = Rules("", (RuleSet("everything", allows_all=True),))

    @contextmanager
    def passing(*_: Any) -> Iterator[bool]:
        yield False

    with pytest.MonkeyPatch.context() as fault:
        fault.setattr(limiter.TopicLimits, "fit", lambda *_: False)
        fault.setattr(limiter.TopicLimits, "passing", passing)
        fault.setattr(limiter.TopicLimits, "needs_value", lambda *_: False)
        fault.setattr(limiter.Limiter, "publishing", lambda _, *asked: everything.topic(*asked))
        fault.setattr(limiter.Limiter, "check_call", lambda *_: None)
        yield
