"""Recording 20 topics at 50 Hz and a VGA camera at 15 Hz: nothing lost, and the CPU beside that of a minimal program.

Run it as `python -m bench.recording [SECONDS]`. Both record the same messages at the same time; the other one is rclpy
alone, which subscribes raw and writes with the same MCAP library.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TOPICS, RATE_HZ, CAMERA_HZ = 20, 50.0, 15.0
SOURCES = Path(__file__).parent.parent / "src"

MINIMAL = """
import sys, time, rclpy
from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, Imu
rclpy.init()
node = rclpy.create_node("minimal_recorder")
writer = Writer(open(sys.argv[1], "wb"), compression=CompressionType.NONE)
writer.start("ros2")
def listen(topic, kind, name):
    channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", b""))
    def keep(data):
        now = time.time_ns()
        writer.add_message(channel, now, data, now)
    node.create_subscription(kind, topic, keep, QoSProfile(depth=1000), raw=True)
for number in range(20):
    listen(f"/imu_{number}", Imu, "sensor_msgs/msg/Imu")
listen("/camera", Image, "sensor_msgs/msg/Image")
print("ready", flush=True)
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
used = time.process_time()
writer.finish()
print(used, flush=True)
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
    """Processor time of a process and its descendants so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    own = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return own + sum(cpu_s(int(child)) for child in children)


def start(code: str, *arguments: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    return process


def main(seconds: float) -> None:
    sys.path.insert(0, str(SOURCES.parent / "tests" / "ros" / "server"))
    from agent import agent_for

    with tempfile.TemporaryDirectory() as folder:
        robot = start(ROBOT)
        try:
            with agent_for(dict(os.environ), "--tools", "all", "--record-dir", folder) as agent:
                agent.call("ros2_topic_list")
                minimal = start(MINIMAL, str(Path(folder) / "minimal.mcap"), str(seconds + 6))
                agent.call("ros2_record_start", patterns=["/imu_*", "/camera"], name="ours")
                time.sleep(1.0)
                server, minimal_before = server_pid(), cpu_s(minimal.pid)
                before, begun = cpu_s(server), time.monotonic()
                time.sleep(seconds)
                ours, theirs = cpu_s(server) - before, cpu_s(minimal.pid) - minimal_before
                elapsed = time.monotonic() - begun
                state = agent.call("ros2_record_stop", recording_id="ours")
                minimal.kill()
        finally:
            robot.kill()
    topics = state["topics"]
    lost, dropped = sum(topic["lost"] or 0 for topic in topics), sum(topic["dropped"] for topic in topics)
    print(f"recorded {state['messages']} messages of {len(topics)} topics, {state['bytes']} bytes; {lost=} {dropped=}")
    print("lost:", {topic["topic_name"]: topic["lost"] for topic in topics if topic["lost"] != 0})
    print(f"CPU: server and bridge {100 * ours / elapsed:.1f} %, minimal program {100 * theirs / elapsed:.1f} %")
    print(f"ratio {ours / theirs:.2f}")


def server_pid() -> int:
    """The server that the client in this process has started."""
    for task in Path("/proc/self/task").iterdir():
        for pid in (task / "children").read_text().split():
            if b"ros2_mcp\0" in Path(f"/proc/{pid}/cmdline").read_bytes():
                return int(pid)
    raise RuntimeError("there is no server")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
