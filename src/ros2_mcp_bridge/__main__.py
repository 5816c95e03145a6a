# pyright: basic
"""The bridge as a process: its stdin and stdout are the stream to the server. See docs/reference/stream.md."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from functools import partial
from typing import Any

from . import definitions, interfaces
from .loop import Loop, log_failure
from .packets import PacketError
from .request import Request
from .stream import Outbox, claim_standard_streams, read_packets

FAILSAFES_AFTER_S = 0.3
GIVE_UP_AFTER_S = 1.0


def main():
    """Run the bridge until its stdin ends; does not return."""
    incoming, outgoing = claim_standard_streams()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C goes to the server, which then closes us
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends us if all else hangs; it may have been inherited as ignored
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # for sigwait in a thread of ours
    Bridge(incoming, outgoing).run()


class Bridge:
    """The threads of the bridge, and how they end together."""

    def __init__(self, incoming, outgoing):
        self._loop = Loop()
        self._outbox = Outbox()
        self._ros_is_up = threading.Event()
        self._operations: Any = None
        self._ending = threading.Lock()
        self._start_thread(self._read, incoming)
        self._writer = self._start_thread(self._outbox.write_packets, outgoing)
        self._start_thread(signal.sigwait, {signal.SIGTERM})

    def run(self):
        """Be the ROS thread; ends the process."""
        missing = "no_rclpy"
        try:
            from . import operations, ros

            missing = "init_failed"
            node, executor = ros.enter(f"ros2_mcp_{os.getpid()}")
            self._operations = operations.Operations(node, self._loop, self._outbox)
        except Exception as error:  # noqa: BLE001 - a broken installation can raise anything here
            self._fail(missing, error)
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
            except PacketError as error:
                sys.stderr.write(f"the stream from the server is broken: {error}\n")
            finally:
                self._end()

        thread = threading.Thread(target=work_then_end, daemon=True)
        thread.start()
        return thread

    def _end(self):
        if self._ending.acquire(blocking=False):
            signal.setitimer(signal.ITIMER_REAL, GIVE_UP_AFTER_S)  # ends the process, even where nothing of Python runs
            threading.Timer(FAILSAFES_AFTER_S, self._carry_out_failsafes).start()
            self._loop.end()

    def _carry_out_failsafes(self):
        if self._operations is not None:
            self._operations.failsafes.carry_out()

    def _fail(self, kind, error):
        log_failure(None, error)
        self._outbox.send({"event": "failed", "kind": kind, "message": f"{type(error).__name__}: {error}"})
        self._exit(1)

    def _exit(self, status):
        # threads of ours may still wait for the stream, which the interpreter's own end does not survive
        self._outbox.finish()
        self._writer.join(0.2)
        sys.stderr.flush()
        os._exit(status)

    def _read(self, incoming):
        for header, body in read_packets(incoming):
            request = Request(header, body)
            try:
                self._accept(request)
            except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
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
