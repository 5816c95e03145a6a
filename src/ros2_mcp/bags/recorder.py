"""A recording in progress: the event loop puts samples, a thread writes them, and limits end it.

Samples are handed to the operating system within `FLUSH_S`, however slowly the disk syncs.
"""

from __future__ import annotations

import os
import shutil
import threading
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.samples import Sample

FLUSH_S = 0.3
"""At most this much time is lost when the process is killed; a shorter one would make many small chunks."""
QUEUE_BYTES = 128_000_000
"""Four seconds of a camera at 30 MB/s: how long a disk may stall before messages are dropped. Raw full-HD images arrive
in bursts of ten (62 MB) after the middleware has repaired a loss."""
_WAKE_BYTES = 4_000_000
"""Waiting bytes that wake the writing thread early: a full-HD camera fills the queue in less than `FLUSH_S`."""
FREE_FLOOR_BYTES = 500_000_000
"""Kept free, because a robot whose disk is full loses its logs and often its software too."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits at which a recording ends by itself; 0 is no limit. `free_floor_bytes` are kept free on the disk."""

    duration_s: float = 0.0
    max_bytes: int = 0
    free_floor_bytes: int = FREE_FLOOR_BYTES


class Recorder:
    """Writes samples in a thread of its own. `ended` is the reason why the recording ended, empty while it runs.

    `failed` is true if the reason was an error of the disk. `dropped` counts, by topic, samples dropped because the
    disk was too slow; samples after the end are ignored. All methods may be called from any thread. `fsync` runs in a
    second thread, so that a slow disk does not delay the writes to the operating system.
    """

    def __init__(self, sink: BagWriter, folder: str | os.PathLike[str], limits: Limits | None = None) -> None:
        self.sink = sink
        self.ended = ""
        self.failed = False
        self.dropped: dict[str, int] = {}
        self.elapsed_s = 0.0
        self._folder = folder
        self._limits = limits or Limits()
        self._waiting: deque[tuple[str, Sample]] = deque()
        self._waiting_bytes = 0
        self._topics: deque[tuple[StoredTopic, str]] = deque()
        self._news = threading.Condition()
        self._stop = ""
        self._started = monotonic()
        self._syncing: Future[None] | None = None
        self._syncer = ThreadPoolExecutor(1, "recording-sync")
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def notes(self) -> Sequence[str]:
        """Notes for the reader of the recording, in sentences."""
        return self.sink.notes

    def add_topic(self, topic: StoredTopic, type_hash: str = "") -> None:
        """Add a topic. Samples of it may be put from now on."""
        with self._news:
            self._topics.append((topic, type_hash))

    def put(self, topic_name: str, samples: Sequence[Sample]) -> None:
        """Queue samples for writing. Samples that do not fit in the queue are dropped and counted."""
        with self._news:
            if self.ended:
                return
            for sample in samples:
                if self._waiting_bytes + len(sample.data) > QUEUE_BYTES:
                    self.dropped[topic_name] = self.dropped.get(topic_name, 0) + 1
                    continue
                self._waiting.append((topic_name, sample))
                self._waiting_bytes += len(sample.data)
            if self._waiting_bytes >= _WAKE_BYTES:
                self._news.notify()

    def stop(self, reason: str = "stopped") -> None:
        """End the recording: write the queued samples, close the files, and wait until both are done."""
        with self._news:
            self._stop = self._stop or reason
            self._news.notify()
        self._thread.join()

    # ── in the thread ──────────────────────────────────────────────────────────────────────────────────────────

    def _run(self) -> None:
        reason = "A fault of this server ended it; see the server's log."
        try:
            reason = self._write_until_the_end()
            self._settle_sync()
            self.sink.close()
        except OSError as error:
            self.failed = True
            reason = f"Writing to the disk failed: {error.strerror or error}."
            with suppress(OSError):
                self._settle_sync()
            with suppress(OSError):
                self.sink.abandon()
        finally:
            self.elapsed_s = monotonic() - self._started
            self._syncer.shutdown()
            with self._news:
                self.ended = reason

    def _write_until_the_end(self) -> str:
        """Write the queue every `FLUSH_S`, or sooner if it is large, until the recording ends; return the reason."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._stop or self._waiting_bytes >= _WAKE_BYTES, FLUSH_S)
                stop = self._stop
            self.elapsed_s = monotonic() - self._started
            reason = stop or self._limit_reached()
            self._write_waiting()
            if self._is_full():
                reason = f"The limit of {self._limits.max_bytes} bytes is reached."
            self.sink.flush()
            if reason:
                return reason
            self._sync()

    def _write_waiting(self) -> None:
        with self._news:
            waiting, self._waiting = self._waiting, deque()
            self._waiting_bytes = 0
            topics, self._topics = self._topics, deque()
        for topic, type_hash in topics:
            self.sink.add_topic(topic, type_hash)
        for topic_name, sample in waiting:
            if self._is_full():
                return  # samples after the limit are not part of the recording
            self.sink.write(topic_name, sample)

    def _is_full(self) -> bool:
        return bool(self._limits.max_bytes) and self.sink.size >= self._limits.max_bytes

    def _limit_reached(self) -> str:
        limits = self._limits
        if limits.duration_s and self.elapsed_s >= limits.duration_s:
            return f"The time of {limits.duration_s:g} s is over."
        if not self._is_full() and (free := shutil.disk_usage(self._folder).free) < limits.free_floor_bytes:
            self.failed = True
            return f"The disk is nearly full: {free} bytes are free, {limits.free_floor_bytes} must stay free."
        return ""

    def _sync(self) -> None:
        """Start an `fsync` in the second thread, one at a time, without waiting for it."""
        if self._syncing is None or self._syncing.done():
            self._settle_sync()
            self._syncing = self._syncer.submit(_fsync, os.dup(self.sink.descriptor))

    def _settle_sync(self) -> None:
        if self._syncing is not None:
            self._syncing.result()


def _fsync(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
