"""A camera: `camera_peer.py WIDTH HEIGHT HZ [compressed] [scene] [reliable]` publishes /camera/image_raw, and the same
compressed.

The raw pictures are noise, which nothing makes smaller, or a `scene` such as cameras see; the compressed ones are real
JPEG. They are best effort, or `reliable` as those of drivers that publish with image_transport's default.
It says `ready`, answers each line of its stdin with how many raw pictures it has published, and ends with it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image

from support.leaving import leave_on_sigterm


def main() -> None:
    width, height, hertz = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("camera")
    profile = 10 if "reliable" in sys.argv else qos_profile_sensor_data
    raw = node.create_publisher(Image, "/camera/image_raw", profile)
    image = Image(width=width, height=height, encoding="rgb8", step=3 * width, data=os.urandom(3 * width * height))
    if "scene" in sys.argv:
        image.data = scene_of(width, height)
    image.header.frame_id = "camera"
    small = None
    if "compressed" in sys.argv:
        small = node.create_publisher(CompressedImage, "/camera/image_raw/compressed", qos_profile_sensor_data)
    jpeg = CompressedImage(format="rgb8; jpeg compressed bgr8", data=jpeg_of(width, height))

    published = 0

    def tick() -> None:
        nonlocal published
        image.header.stamp = jpeg.header.stamp = node.get_clock().now().to_msg()
        raw.publish(image)
        published += 1
        if small:
            small.publish(jpeg)

    node.create_timer(1 / hertz, tick)

    def answer() -> None:
        for _ in sys.stdin:
            print(published, flush=True)
        os.kill(os.getpid(), signal.SIGTERM)

    told_to_end = threading.Event()
    leave_on_sigterm(told_to_end.set)
    threading.Thread(target=answer, daemon=True).start()
    print("ready", flush=True)
    while not told_to_end.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()
    os._exit(0)  # the daemon thread may still wait for its input


def scene_of(width: int, height: int) -> bytes:
    """Smooth surfaces, edges and a little noise."""
    from PIL import Image as Picture
    from PIL import ImageChops, ImageDraw

    surface = Picture.radial_gradient("L").resize((width, height))
    picture = Picture.merge("RGB", (surface, Picture.linear_gradient("L").resize((width, height)), surface))
    pen = ImageDraw.Draw(picture)
    for number in range(12):
        left, top = number * width // 12, (number * 5 % 12) * height // 12
        pen.rectangle((left, top, left + width // 16, height), fill=(number * 20, 200 - number * 15, 90))
    noise = Picture.effect_noise((width, height), 6).convert("RGB")
    return ImageChops.add(picture, noise, 1, -128).tobytes()


def jpeg_of(width: int, height: int) -> bytes:
    """A real picture of that size."""
    from io import BytesIO

    from PIL import Image as Picture

    data = BytesIO()
    Picture.effect_noise((width, height), 40).convert("RGB").save(data, "JPEG", quality=60)
    return data.getvalue()


if __name__ == "__main__":
    main()
