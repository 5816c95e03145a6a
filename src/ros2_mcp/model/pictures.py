"""Pictures for the model, the message types that are pictures, and options for drawing."""

from __future__ import annotations

from dataclasses import dataclass

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"

MAX_SIDE = 1568
"""Pixels. Vision models scale down larger sides, so more would cost time and show nothing."""
MAX_BYTES = 700_000
"""Clients accept results of up to 1 MB; base64 makes 933 kB of this, and the rest is room for the text."""


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded picture; `note` says what it shows and how it was processed.

    `whole` is its original size (width, height) if it was scaled down to the bounds; (0, 0) if not.
    """

    data: bytes
    mime: str
    width: int
    height: int
    note: str
    whole: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of a picture: pixels of its longer side, bytes of its file."""

    max_side: int = MAX_SIDE
    max_bytes: int = MAX_BYTES


BOUNDS = Bounds()
"""The default bounds."""


@dataclass(frozen=True, slots=True)
class Place:
    """A position and heading in a frame, seen from above: metres, and radians from x towards y."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotPlace(Place):
    """The place of a robot with its height, and the stamp of the pose; None: the robot is fixed there."""

    z_m: float = 0.0
    stamp_ns: int | None = None


@dataclass(frozen=True, slots=True)
class BirdEyeOptions:
    """Options for drawing a cloud from above: metres per pixel, the part shown, and the colours.

    A limit of None means all heights, or, for x and y, the extent of the points without outliers. `color_mode` is
    `intensity`, `height` or `rgb`, `colormap` is `jet` or `gray`.
    """

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
