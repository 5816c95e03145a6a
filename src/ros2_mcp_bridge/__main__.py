# pyright: basic
"""The bridge as a process: its stdin and stdout are the stream to the server. See docs/reference/stream.md."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from functools import partial
from typing import Any

from . import definitions, frames, interfaces
from .loop import Loop
from .request import OperationError, Request
from .stream import Outbox, claim_standard_streams, read_frames

FINALS_AFTER_S = 0.3
GIVE_UP_AFTER_S = 1.0


def main(argv=None):
    """Run the bridge until its stdin ends; does not return."""
    incoming, outgoing = claim_standard_streams()
    parser = argparse.ArgumentParser(prog="ros2_mcp_bridge", description=__doc__)
    parser.add_argument("--node-name", default=f"ros2_mcp_{os.getpid()}")
    arguments = parser.parse_args(argv)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C goes to the server, which then closes us
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # for sigwait in a thread of ours
    if not os.environ.get("HOME"):
        os.environ.setdefault("ROS_LOG_DIR", tempfile.gettempdir())
    Bridge(incoming, outgoing).run(arguments.node_name)


class Bridge:
    """The threads of the bridge, and how they end together."""

    def __init__(self, incoming, outgoing):
        self._loop = Loop()
        self._outbox = Outbox()
        self._ros_is_up = threading.Event()
        self._operations: Any = None
        self._ending = threading.Lock()
        self._start_thread(self._read, incoming)
        self._writer = self._start_thread(self._outbox.write_frames, outgoing)
        self._start_thread(signal.sigwait, {signal.SIGTERM})

    def run(self, node_name):
        """Be the ROS thread; ends the process."""
        try:
            from . import operations, ros
        except Exception as error:  # noqa: BLE001 - a broken installation can raise anything here
            self._fail("no_rclpy", error)
        try:
            node, executor = ros.enter(node_name)
            self._operations = operations.Operations(node, self._loop, self._outbox)
        except Exception as error:  # noqa: BLE001 - as above
            self._fail("init_failed", error)
        self._outbox.send(ros.hello(node, executor))
        self._ros_is_up.set()
        self._loop.run(executor)
        self._operations.end(executor)
        ros.leave(node, executor)
        self._exit(0)

    def _start_thread(self, work, argument):
        """A thread that ends the bridge when it ends."""

        def work_then_end():
            try:
                work(argument)
            except frames.FrameError as error:
                sys.stderr.write(f"the stream from the server is broken: {error}\n")
            finally:
                self._end()

        thread = threading.Thread(target=work_then_end, daemon=True)
        thread.start()
        return thread

    def _end(self):
        if self._ending.acquire(blocking=False):
            threading.Thread(target=self._enforce_end, daemon=True).start()
            self._loop.end()

    def _enforce_end(self):
        time.sleep(FINALS_AFTER_S)
        if self._operations is not None:
            self._operations.last_deeds()
        time.sleep(GIVE_UP_AFTER_S - FINALS_AFTER_S)
        os._exit(1)

    def _fail(self, kind, error):
        traceback.print_exception(type(error), error, error.__traceback__, file=sys.stderr)
        self._outbox.send({"event": "failed", "kind": kind, "message": f"{type(error).__name__}: {error}"})
        self._exit(1)

    def _exit(self, status):
        # threads of ours may still wait for the stream, which the interpreter's own end does not survive
        self._outbox.finish()
        self._writer.join(0.2)
        sys.stderr.flush()
        os._exit(status)

    def _read(self, incoming):
        for header, body in read_frames(incoming):
            request = Request(header, body)
            try:
                self._accept(request)
            except OperationError as error:
                self._outbox.reply_error(request.id, error)

    def _accept(self, request):
        """Answer what needs no ROS; prepare the rest on this thread, so that the ROS thread never waits for imports."""
        if request.op == "ping":
            self._outbox.reply(request.id, {"ros_idle_s": round(time.monotonic() - self._loop.last_turn, 6)})
        elif request.op == "interfaces":
            self._outbox.reply(request.id, {"interfaces": definitions.interfaces()})
        elif request.op == "definitions":
            found, missing = definitions.definitions(request.texts("types"))
            self._outbox.reply(request.id, {"definitions": found, "missing": missing})
        else:
            self._ros_is_up.wait()
            if request.has("type"):
                request.interface = interfaces.load(request.text("type"))
            self._loop.submit(partial(self._operations.start, request))


if __name__ == "__main__":
    main()
