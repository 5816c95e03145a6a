"""Pictures as they travel to the model, which messages are pictures, and how pictures may be asked for."""

from __future__ import annotations

from dataclasses import dataclass

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"

MAX_SIDE = 1568
"""Pixels. Vision models scale down what is longer, so more would cost time and show nothing."""
MAX_BYTES = 700_000
"""Clients take results of up to 1 MB; base64 makes 933 kB of this, which leaves room for the text."""


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded picture; `note` says what it shows and what was done to it, in words.

    `whole` is how large it was (width, height) before it was made smaller to keep to bounds; (0, 0): it was not.
    """

    data: bytes
    mime: str
    width: int
    height: int
    note: str
    whole: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a picture must keep to: pixels of its longer side, bytes of its file."""

    max_side: int = MAX_SIDE
    max_bytes: int = MAX_BYTES


BOUNDS = Bounds()
"""The bounds where nothing else is asked for."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where something is in a frame, seen from above: metres, and radians from x towards y."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotPlace(Place):
    """The place of a robot, with its height, and the time of which it is told; None: it is fixed there."""

    z_m: float = 0.0
    stamp_ns: int | None = None


@dataclass(frozen=True, slots=True)
class BirdEyeOptions:
    """How to look at a cloud: metres for each pixel, the part shown (heights: None is all; x and y: None is where the
    points are, without outliers), `intensity`, `height` or `rgb` as colour, `jet` or `gray` as the scale of colours."""

    resolution_m: float = 0.05
    x_min_m: float | None = None
    x_max_m: float | None = None
    y_min_m: float | None = None
    y_max_m: float | None = None
    z_min_m: float | None = None
    z_max_m: float | None = None
    color_mode: str = "intensity"
    colormap: str = "jet"
    bounds: Bounds = BOUNDS
