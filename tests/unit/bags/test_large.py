"""The last messages of one topic are read from the end of a large bag, with little memory; in full, within a second."""

from __future__ import annotations

import math
import time
import tracemalloc
from pathlib import Path

from ros2_mcp.bags.bag import Bag
from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample
from support.rounds import FULL

BYTES = 5_000_000_000 if FULL else 100_000_000
PICTURE = bytes(900_000)


def test_the_last_hundred_messages_of_a_topic_are_read_alone(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path, "large")
    for topic in ("/camera", "/slow"):
        writer.add_topic(StoredTopic(topic, "demo/msg/Raw", None, "ros2msg", "uint8[] data\n"))
    count = BYTES // len(PICTURE)
    for number in range(count):
        at_ns = 10**18 + number * 66_000_000
        writer.write("/camera", Sample(at_ns, at_ns, number + 1, PICTURE))
        writer.write("/slow", Sample(at_ns + 1, at_ns, number + 1, number.to_bytes(4, "little")))
        if number % 8 == 0:
            writer.flush()
    writer.close()
    tracemalloc.start()
    elapsed = math.inf
    for _ in range(3):  # the best of at most three: a machine that stalls is no slow bag
        with Bag(tmp_path) as bag:
            begun = time.monotonic()
            slow, camera = bag.last("/slow", 100), bag.last("/camera", 20)
            elapsed = min(elapsed, time.monotonic() - begun)
        if elapsed < 1.0:
            break
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    writer.path.unlink()
    assert [int.from_bytes(sample.data, "little") for sample in slow] == list(range(count - 100, count))
    assert len(camera) == 20
    print(f"{BYTES} bytes: opened and read in {elapsed:.3f} s, {most} bytes of memory")
    if FULL:
        assert elapsed < 1.0
    assert most < 20 * len(PICTURE) + 30_000_000
