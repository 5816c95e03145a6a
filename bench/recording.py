"""Recording 20 topics at 50 Hz and a VGA camera at 15 Hz: nothing lost, and the CPU beside that of a minimal program.

Run it as `python -m bench.recording [SECONDS]`; the promise is about 300. Both record the same messages at the same
time; the other one is rclpy alone, which subscribes raw and writes with the same MCAP library. What each has lost is
counted by the gaps in the publishers' sequence numbers: ours in the file, once it is closed, the other's as they come.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from .stdio import StdioClient

TOPICS, RATE_HZ, CAMERA_HZ = 20, 50.0, 15.0

MINIMAL = """
import signal, sys, time, rclpy
from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, Imu
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
ending = []
signal.signal(signal.SIGTERM, lambda *_: ending.append(True))
last, lost = {}, {}
node = rclpy.create_node("minimal_recorder")
writer = Writer(open(sys.argv[1], "wb"), compression=CompressionType.NONE)
writer.start("ros2")
def listen(topic, kind, name):
    channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", b""))
    def keep(data, info):
        now = time.time_ns()
        writer.add_message(channel, now, data, now)
        number = info["publication_sequence_number"]
        lost[topic] = lost.get(topic, 0) + number - last.get(topic, number - 1) - 1
        last[topic] = number
    node.create_subscription(kind, topic, keep, QoSProfile(depth=1000), raw=True)
for number in range(20):
    listen(f"/imu_{number}", Imu, "sensor_msgs/msg/Imu")
listen("/camera", Image, "sensor_msgs/msg/Image")
print("ready", flush=True)
while not ending:
    rclpy.spin_once(node, timeout_sec=0.1)
print({topic: count for topic, count in lost.items() if count}, flush=True)
"""

ROBOT = """
import time, rclpy
from sensor_msgs.msg import Image, Imu
rclpy.init()
node = rclpy.create_node("bench_robot")
imus = [node.create_publisher(Imu, f"/imu_{number}", 100) for number in range(20)]
camera = node.create_publisher(Image, "/camera", 10)
image = Image(height=480, width=640, step=1920, encoding="rgb8", data=bytes(640 * 480 * 3))
print("ready", flush=True)
imu, frames, rounds, begun = Imu(), 0, 0, time.monotonic()
while True:
    due = begun + min(rounds / 50.0, frames / 15.0)
    time.sleep(max(0.0, due - time.monotonic()))
    if rounds / 50.0 <= frames / 15.0:
        rounds += 1
        for publisher in imus:
            publisher.publish(imu)
    else:
        frames += 1
        camera.publish(image)
"""


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process and its descendants so far, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    own = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return own + sum(cpu_s(int(child)) for child in children)


def start(code: str, *arguments: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    return process


async def main(seconds: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        robot = start(ROBOT)
        try:
            options = ("--tools", "all", "--record-dir", folder)
            async with StdioClient([sys.executable, "-m", "ros2_mcp", *options], os.environ) as client:
                await client.greet()
                await client.call("ros2_topic_list")
                minimal = start(MINIMAL, str(Path(folder) / "minimal.mcap"))
                await client.call("ros2_record_start", patterns=["/imu_*", "/camera"], name="ours")
                await asyncio.sleep(1.0)
                server, minimal_before = client.pid, cpu_s(minimal.pid)
                before, begun = cpu_s(server), time.monotonic()
                await asyncio.sleep(seconds)
                ours, theirs = cpu_s(server) - before, cpu_s(minimal.pid) - minimal_before
                elapsed = time.monotonic() - begun
                state = await client.call("ros2_record_stop", recording_id="ours")
                minimal.terminate()
                minimal_lost = minimal.communicate(timeout=20)[0].strip()
            missing = gaps(Path(folder) / "ours")
        finally:
            robot.kill()
    topics = state["topics"]
    lost, dropped = sum(topic["lost"] or 0 for topic in topics), sum(topic["dropped"] for topic in topics)
    print(f"recorded {state['messages']} messages of {len(topics)} topics, {state['bytes']} bytes; {lost=} {dropped=}")
    print("lost as told:", {topic["topic_name"]: topic["lost"] for topic in topics if topic["lost"] != 0})
    print("missing in our file:", missing, "· lost by the minimal program:", minimal_lost)
    print(f"CPU: server and bridge {100 * ours / elapsed:.1f} %, minimal program {100 * theirs / elapsed:.1f} %")
    print(f"ratio {ours / theirs:.2f}")


def gaps(bag_path: Path) -> dict[str, int]:
    """Return the number of missing messages between the first and the last one of each topic, for topics with any."""
    from ros2_mcp.bags.bag import Bag

    last: dict[str, int] = {}
    missing: dict[str, int] = {}
    with Bag(bag_path) as bag:
        for topic, sample in bag.messages():
            number = sample.sequence or 0
            missing[topic] = missing.get(topic, 0) + number - last.get(topic, number - 1) - 1
            last[topic] = number
    return {topic: count for topic, count in missing.items() if count}


if __name__ == "__main__":
    parser = argparse.ArgumentParser("bench.recording", description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=10.0, help="for how long (default: 10)")
    asyncio.run(main(parser.parse_args().seconds))
