"""Large messages: recording raw pictures and clouds, and reading a picture."""

from __future__ import annotations

import asyncio
import io
import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags.typesys import Stores, get_typestore

from .processes import Peer, cpu_seconds, ours
from .report import Row
from .stdio import StdioClient

SETTLE_S = 1.0


async def recording(duration_s: int, rounds: int) -> list[Row]:
    """Record raw 1080p pictures at 30 Hz and clouds of 2 MB at 10 Hz, alternately with our server and with bare rclpy
    and mcap."""
    lost: list[int] = []
    bare_lost: list[int] = []
    cpu: list[float] = []
    bare_cpu: list[float] = []
    notes: list[str] = []
    with tempfile.TemporaryDirectory() as folder, Peer("sights") as robot:
        async with ours("--tools", "all", "--record-dir", folder) as us:
            await us.greet()
            await us.call("ros2_topic_list")
            bridge = (await us.call("ros2_status"))["bridge_pid"]
            for _ in range(rounds):
                missing, used = await _by_bare(robot, Path(folder) / "bare.mcap", duration_s)
                bare_lost.append(missing)
                bare_cpu.append(used)
                missing, used, note = await _by_us(robot, us, (us.pid, bridge), duration_s)
                lost.append(missing)
                cpu.append(used)
                notes.append(note)
                shutil.rmtree(Path(folder) / "ours")
    what = f"recording 1080p at 30 Hz and 2 MB at 10 Hz, {duration_s} s"
    spread = f"each turn: {lost}, bare rclpy {bare_lost}"
    return [
        Row(f"{what}: messages lost beyond bare rclpy", max(0, sum(lost) - sum(bare_lost)), "", 0, note=spread),
        Row(f"{what}: processor", sum(cpu) / rounds, "s", 1.2, sum(bare_cpu) / rounds, note="; ".join(notes)),
    ]


async def picture_read(rounds: int) -> list[Row]:
    """Read a raw 1080p picture as a JPEG; the floor only decodes it, scales it to the same size, and encodes it."""
    store, name = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/Image"
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, 0), "camera")
    rows, columns = np.mgrid[0:1080, 0:1920]
    smooth = np.stack([columns / 8, rows / 5, (rows + columns) / 12], axis=2)
    pixels = np.clip(smooth + np.random.default_rng(1).normal(0, 6, smooth.shape), 0, 255).astype(np.uint8)
    data = bytes(store.serialize_cdr(store.types[name](header, 1080, 1920, "rgb8", 0, 5760, pixels.reshape(-1)), name))

    def floor() -> None:
        message: Any = store.deserialize_cdr(data, name)
        whole = Image.fromarray(message.data.reshape(1080, 1920, 3))
        small = whole.resize((1568, 882), Image.Resampling.BILINEAR, reducing_gap=2.0)
        small.save(io.BytesIO(), "JPEG", quality=85)

    floor()
    began = time.thread_time()
    for _ in range(rounds):
        floor()
    bare = time.thread_time() - began
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        with Peer("picture", file.name):
            async with ours() as us:
                await us.greet()
                (shown,) = (await us.call("ros2_topic_subscribe", topic_name="/bench/picture"))["pictures"]
                assert (shown["width"], shown["height"]) == (1568, 882)
                before, began = cpu_seconds(us.pid), time.perf_counter()
                for _ in range(rounds):
                    await us.call("ros2_topic_subscribe", topic_name="/bench/picture")
                took, used = time.perf_counter() - began, cpu_seconds(us.pid) - before
    note = f"to the answer {took / rounds * 1000:.0f} ms"
    return [Row("a 1080p picture read: the server", used / rounds * 1000, "ms", 1.3, bare / rounds * 1000, note=note)]


async def _by_bare(robot: Peer, path: Path, duration_s: int) -> tuple[int, float]:
    with Peer("recorder") as bare:
        before = cpu_seconds(bare.pid)
        writing = asyncio.ensure_future(asyncio.to_thread(robot.ask, str(duration_s)))
        bare.tell(str(path))
        sent, _ = json.loads(await writing)
        await asyncio.sleep(SETTLE_S)
        written = int(await asyncio.to_thread(bare.ask, ""))
        used = cpu_seconds(bare.pid) - before
    await asyncio.to_thread(path.unlink)
    return sent - written, used


async def _by_us(robot: Peer, us: StdioClient, pids: tuple[int, int], duration_s: int) -> tuple[int, float, str]:
    before = [cpu_seconds(pid) for pid in pids]
    await us.call("ros2_record_start", patterns=["/bench/sight*"], name="ours")
    sent, took_s = json.loads(await asyncio.to_thread(robot.ask, str(duration_s)))
    await asyncio.sleep(SETTLE_S)
    state: dict[str, Any] = await us.call("ros2_record_stop")
    used = [cpu_seconds(pid) - then for pid, then in zip(pids, before, strict=True)]
    told = ", ".join(f"{one['topic_name'][-6:]} {one['dropped']} dropped {one['lost']} lost" for one in state["topics"])
    parts = f"server {used[0]:.2f}, bridge {used[1]:.2f} s, sent in {took_s:.1f} s, {told}, {' '.join(state['notes'])}"
    return sent - state["messages"], sum(used), parts.rstrip(", ")
