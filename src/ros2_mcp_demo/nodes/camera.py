"""/camera: colour and depth pictures, rendered only while there are subscribers."""

# pyright: basic
from __future__ import annotations

import io
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from .. import optional, picture
from .convert import octets
from .part import ERROR, OK, RobotPart

JPEG_QUALITY = 80
FRAME = "camera_optical"


class Camera(RobotPart):
    """The driver of the colour and depth camera."""

    def __init__(self, robot, namespace):
        super().__init__("camera", robot, namespace)
        self.declare_switch("enabled", True, "False: the camera is dead and publishes nothing")
        self.declare_number("frame_rate", 10.0, 0.5, 25.0, "Colour pictures per second [Hz]")
        self.declare_number("brightness", 1.0, 0.0, 2.0, "1 is right, 0 is black")
        self.declare_text("sign", "", "What stands on a sign that it reads, and tells its log every two seconds")
        self._raw = self.create_publisher(Image, "camera/image_raw", 5)
        self._info = self.create_publisher(CameraInfo, "camera/camera_info", 5)
        self._depth = self.create_publisher(Image, "camera/depth/image_raw", 5)
        self._jpeg: Any = None
        if optional.pillow:
            self._jpeg = self.create_publisher(CompressedImage, "camera/image_raw/compressed", 5)

    def tick(self, stamp):
        """Publish the pictures that are due and have subscribers."""
        if not self.setting("enabled"):
            return
        if (sign := self.setting("sign")) and self.is_due(0.5, "sign"):
            self.get_logger().warning(f"reads a sign: {sign}")
        rate = self.setting("frame_rate")
        if self.is_due(rate, "color"):
            self._publish_color(stamp)
        if self.is_due(rate / 2, "depth") and self._depth.get_subscription_count():
            depth = self.robot.depth_photo()
            self._depth.publish(self._image(stamp, depth, "32FC1", 4))

    def diagnosis(self):
        """Return whether the camera works."""
        values = {"frame rate [Hz]": f"{self.setting('frame_rate'):g}"}
        return (OK, "ready", values) if self.setting("enabled") else (ERROR, "no data from the camera", values)

    def _publish_color(self, stamp):
        raw, jpeg = self._raw.get_subscription_count(), self._jpeg and self._jpeg.get_subscription_count()
        if raw or jpeg:
            photo = self.robot.photo(self.setting("brightness"))
            if raw:
                self._raw.publish(self._image(stamp, photo, "rgb8", 3))
            if jpeg:
                file = io.BytesIO()
                optional.pillow.fromarray(photo).save(file, "JPEG", quality=JPEG_QUALITY)
                message = CompressedImage(format="rgb8; jpeg compressed bgr8")
                message.data.frombytes(file.getvalue())
                self._jpeg.publish(self.headed(message, stamp, FRAME))
        if raw or jpeg or self._info.get_subscription_count():
            self._info.publish(self._calibration(stamp))

    def _image(self, stamp, pixels, encoding, pixel_bytes):
        message = Image(height=picture.HEIGHT, width=picture.WIDTH, encoding=encoding)
        message.step = picture.WIDTH * pixel_bytes
        message.data = octets(pixels)
        return self.headed(message, stamp, FRAME)

    def _calibration(self, stamp):
        focal, x, y = picture.FOCAL, picture.CENTER_X, picture.CENTER_Y
        message = self.headed(CameraInfo(height=picture.HEIGHT, width=picture.WIDTH), stamp, FRAME)
        message.distortion_model, message.d = "plumb_bob", [0.0] * 5
        message.k = [focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0]
        message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        message.p = [focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0]
        return message
