"""The bridge as a process: its stdin and stdout are the stream to the server. See docs/reference/stream.md."""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeVar

from ros2_mcp_bridge.epoch import StopEpoch
from ros2_mcp_bridge.exit.lifeline import Lifeline
from ros2_mcp_bridge.exit.limiter import Limiter
from ros2_mcp_bridge.exit.spawning import STOPPER_ARGUMENT, STOPPERS, copy_process
from ros2_mcp_bridge.lease import LinkLease
from ros2_mcp_bridge.loop import Loop, log_failure
from ros2_mcp_bridge.request import OperationError, Request
from ros2_mcp_bridge.ros import definitions, interfaces
from ros2_mcp_bridge.stream import Outbox, claim_standard_streams, read_packets
from ros2_mcp_common.allocation import keep_freed_memory
from ros2_mcp_common.latch import FILE, Latch, LatchState
from ros2_mcp_common.policy.velocity import SPEED_LIMIT
from ros2_mcp_common.policy.verbs import meaning
from ros2_mcp_common.wire.packets import PacketError
from ros2_mcp_common.wire.protocol import BRIDGE_NODE, Empty, Lapsed, PingReply, PolicyReply

if TYPE_CHECKING:
    from ros2_mcp_bridge.operations import Operation, Operations

T = TypeVar("T")

# The ROS thread carries out the fail-safes when it leaves its loop, usually at once. If it hangs in the middleware,
# another thread does so after this time. Both fit into GIVE_UP_AFTER_S.
FAILSAFES_AFTER_S = 0.3
# From the end of the stream to the end of the process, whatever hangs: time for the fail-safes (0.3 s, and 0.6 s for
# their arrival) and for leaving ROS. The server waits for half a second more.
GIVE_UP_AFTER_S = 1.0
# From the start to the end of the process, if ROS does not start: longer than the server waits (20 s). Once the
# middleware was seen to spin for ever while a participant was destroyed, with the interpreter's lock held: then no
# thread of this process sees the end of the stream, and only the kernel's timer can end the process.
ROS_IS_UP_WITHIN_S = 30.0
# A stop, or a lapsed lease, has to end all motion within 0.1 s; a ROS thread that does not hang makes a turn in a tenth
# of that.
ROS_HANGS_AFTER_S = 0.05
# Operations that always act, and so require an epoch.
ACTING = frozenset({"publish", "repeat", "relay", "relay_feed", "move"})
# Operations that only end something, and start nothing.
ENDING = frozenset({"cancel", "zero", "repeat_stop", "relay_stop"})
# An outage of the network may end after the server has given up this bridge, 4 s after its last sign of life (SILENCE_S
# there). Packets that it had sent then still arrive: old commands, perhaps from before a stop that this bridge never
# receives. So requests sent longer ago than this do not act. It is less than those 4 s, and more than any delay that a
# connection was measured to survive (1.0 s at 15 % loss).
LATE_S = 3.5
# The longest wait for the last packets to be written: they are few, and the reader may be gone.
LAST_WORDS_S = 0.2


def main() -> None:
    """Run the bridge, or a stopper, until its stdin ends. Never returns."""
    options = argparse.ArgumentParser("ros2_mcp_bridge", description=__doc__, allow_abbrev=False)
    options.add_argument("--under-policy", action="store_true", help="nothing leaves but zeros until the rules came")
    options.add_argument("--state", type=Path, metavar="DIR", help="the robot's state folder, with its latch")
    options.add_argument("--orphan-s", type=float, default=0.0, metavar="S", help="leave when nothing came for so long")
    options.add_argument("--arrival", metavar="NONCE", help="say on stdout where the stream begins, as stage 1 does")
    options.add_argument(STOPPER_ARGUMENT, metavar="NAME", help="be a stopper of the bridge that starts it")
    chosen = options.parse_args()
    if chosen.arrival:
        from ros2_mcp_common.start import stage1  # otherwise it ran before this process

        why = f"ros2_mcp_bridge is installed in {Path(__file__).parent}."
        stage1.tell(chosen.arrival, "found", distro=os.environ.get("ROS_DISTRO", ""), python=sys.executable, why=why)
        stage1.tell(chosen.arrival, "bridge")
    incoming, outgoing = claim_standard_streams()
    if chosen.stopper:
        from ros2_mcp_bridge.stopper import stopper  # it needs rclpy

        stopper.main(chosen.stopper, incoming, outgoing)
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C goes to the server, which then ends the bridge
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process if all else hangs; may be inherited as ignored
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # for sigwait in another thread
    signal.setitimer(signal.ITIMER_REAL, ROS_IS_UP_WITHIN_S)
    latch = Latch(chosen.state / FILE if chosen.state else None)
    Bridge(incoming, outgoing, latch=latch, is_under_policy=chosen.under_policy, orphan_s=chosen.orphan_s).run()


class Bridge:
    """The threads of the bridge, and how they end together.

    `_table` has a row for each operation. Those that need no ROS are there from the start, so that they answer while
    ROS starts or hangs; `Operations` adds those of the ROS thread. The reading thread answers pings, raises the stop
    epoch and checks the link lease, and waits for nothing else; the preparing thread takes requests in order. Under a
    policy, nothing but zeros is sent before its rules have come; they come once.
    """

    def __init__(
        self,
        incoming: int,
        outgoing: int,
        *,
        latch: Latch | None = None,
        is_under_policy: bool = False,
        orphan_s: float = 0.0,
    ) -> None:
        self._loop = Loop()
        self._outbox = Outbox()
        self._stops = StopEpoch(latch)
        self._limiter = Limiter(is_under_policy, send_event=self._outbox.send)
        self._accepted: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._ros_is_up = threading.Event()
        self._table: dict[str, Operation] = {
            "ping": self._ping,
            "policy": self._policy,
            "spent": self._spent,
            "interfaces": definitions.list_interfaces,
            "definitions": definitions.find,
        }
        self._without_ros = frozenset(self._table)
        self._operations: Operations | None = None
        self._greeted_s = 0.0
        self._ending = threading.Lock()
        self._lease = LinkLease(incoming, self._lapse, orphan_s=orphan_s, is_at_rest=self._is_at_rest)
        self._start_thread(self._read, incoming)
        self._start_thread(self._prepare, self._accepted)
        self._writer = self._start_thread(self._outbox.write_packets, outgoing)
        self._start_thread(signal.sigwait, {signal.SIGTERM})

    def run(self) -> None:
        """Run the ROS thread, and end the process. Never returns."""
        missing = "no_rclpy"
        try:
            from ros2_mcp_bridge import operations
            from ros2_mcp_bridge.ros import context as ros
            from ros2_mcp_bridge.ros import shared_memory
            from ros2_mcp_bridge.stopper import stopper, udp

            missing = "init_failed"
            operations.load_types()
            copies = {name: copy_process(partial(stopper.main, name)) for name in STOPPERS}
            shared_memory.remove_dead()
            with udp.alone_if_memory_is_full():
                node, executor = ros.enter(f"{BRIDGE_NODE}{os.getpid()}")
            self._operations = operations.Operations(
                node=node,
                loop=self._loop,
                outbox=self._outbox,
                stops=self._stops,
                limiter=self._limiter,
                table=self._table,
                lifeline=Lifeline(self._stopper_lost, self._outbox.send, copies, lambda: self._loop.last_turn),
            )
        except Exception as error:  # noqa: BLE001 - a broken installation can raise anything here
            log_failure(None, error)
            message = f"{type(error).__name__}: {error}"
            self._outbox.send({"event": "failed", "kind": missing, "message": message})
            self._exit(1)
        if not self._ending.locked():
            signal.setitimer(signal.ITIMER_REAL, 0)
            if self._ending.locked():  # the end began in between, and its timer was cancelled
                signal.setitimer(signal.ITIMER_REAL, GIVE_UP_AFTER_S)
        self._greeted_s = time.monotonic()
        self._outbox.send(ros.hello(node, executor))
        self._ros_is_up.set()
        self._loop.run(executor)
        self._operations.end(executor)
        ros.leave(node, executor)
        self._exit(0)

    def _start_thread(self, work: Callable[[T], object], argument: T) -> threading.Thread:
        """Start a thread that ends the bridge when it ends."""

        def work_then_end() -> None:
            try:
                work(argument)
            except PacketError as error:
                sys.stderr.write(f"the stream from the server is broken: {error}\n")
            finally:
                self._end()

        thread = threading.Thread(target=work_then_end, daemon=True)
        thread.start()
        return thread

    def _end(self) -> None:
        if self._ending.acquire(blocking=False):
            signal.setitimer(signal.ITIMER_REAL, GIVE_UP_AFTER_S)  # ends the process even if no Python code runs
            self._stops.lapse()
            if self._operations is not None:
                threading.Timer(FAILSAFES_AFTER_S, self._operations.failsafes.carry_out).start()
            self._loop.end()

    def _exit(self, status: int) -> NoReturn:
        # Other threads may still wait for the stream, which a normal exit of the interpreter does not survive.
        self._outbox.finish()
        self._writer.join(LAST_WORDS_S)
        sys.stderr.flush()
        os._exit(status)

    def _lapse(self, silent_s: float) -> None:
        """End what the server moves, because it is silent: on the ROS thread, or if that thread hangs, first on another
        thread.
        """
        self._stops.lapse()
        self._outbox.send(Lapsed(event="lapsed", silent_s=round(silent_s, 3)))
        if self._operations is not None:
            self._do_first(self._operations.failsafes.carry_out, self._operations.lapse)

    def _is_at_rest(self) -> bool:
        return not self._stops.coming and (self._operations is None or self._operations.is_at_rest())

    def _stopper_lost(self) -> None:
        """Stop all motion, because a stopper that could stop it has died. New motion may begin."""
        if self._operations is not None:
            self._do_first(self._operations.send_zeros, self._operations.end_lasting)

    def _do_first(self, zeros: Callable[[], object], then: Callable[[], object]) -> None:
        """Make the ROS thread send zeros before all else. If they are not sent in time, another thread sends them."""
        hangs = threading.Timer(ROS_HANGS_AFTER_S, zeros)

        def do() -> None:
            zeros()
            hangs.cancel()  # only after they were sent: this turn may hang later
            then()

        self._loop.submit_first(do)
        hangs.start()  # waits for the new thread to run; if cancelled before, it ends at once

    def _read(self, incoming: int) -> None:
        for header, body in read_packets(incoming, self._lease.wait_readable, self._outbox):
            request = Request(header, body)
            if request.op == "policy" and self._limiter.rules is not None:
                raise PacketError("a second policy came")
            try:
                self._accept(request)
            except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
                self._outbox.reply_error(request.id, error)

    def _accept(self, request: Request) -> None:
        """Record when a request was accepted, and queue it; a stop goes before all that waits."""
        if request.op in ("ping", "stop"):
            self._stops.raise_to(request.number("epoch", 0.0 if request.op == "ping" else None))
        elif request.op in ACTING or request.has("epoch") or _calls_what_acts(request):
            now = self._stops.epoch if request.op == "call" else None
            request.acceptance = self._stops.accept(request.number("epoch", now))
            if not request.acceptance.overtaken_by():
                self._stops.coming[request] = None
        if request.op == "ping":
            self._outbox.reply(request.id, self._ping(request))
        elif request.op == "policy":  # here, so that it holds for all requests read after it
            self._outbox.reply(request.id, self._policy(request))
        elif request.op == "stop" and self._operations is not None:
            self._do_first(self._operations.send_zeros, partial(self._operations.start, request))
        else:
            if request.op in ENDING and self._operations is not None:
                self._loop.submit(partial(self._operations.end_at_once, request))
            self._accepted.put(request)

    def _prepare(self, accepted: queue.SimpleQueue[Request]) -> None:
        """Answer requests that need no ROS, and load what the others need, so that the ROS
        thread never waits for imports.
        """
        while True:
            request = accepted.get()
            try:
                self._submit(request)
            except Exception as error:  # noqa: BLE001 - whatever it is, it answers this request
                self._stops.coming.pop(request, None)
                self._outbox.reply_error(request.id, error)

    def _submit(self, request: Request) -> None:
        if request.op in self._without_ros:
            answer = self._table[request.op](request)
            assert isinstance(answer, Mapping)
            self._outbox.reply(request.id, answer)
            return
        self._ros_is_up.wait()
        if request.has("type"):
            request.interface = self._loader(request)(request.text("type"))
        for type_name in request.texts("hears") if request.has("hears") else ():
            interfaces.load(type_name)  # it stays loaded
        if self._limiter.speed_of_goals and request.op == "call" and request.text("type").startswith("nav2_msgs/"):
            with suppress(OperationError):  # an older Nav2, or a part of it, has no such type
                interfaces.load(SPEED_LIMIT)
        if self._operations is not None:
            self._loop.submit(partial(self._operations.start, request))

    @staticmethod
    def _loader(request: Request) -> Callable[[str], object]:
        """Return the loader of a type: a type that is only read here may be a stand-in."""
        if request.op != "subscribe":
            return interfaces.load
        from ros2_mcp_bridge.ros import stand_ins  # with rclpy, which is there by now

        return stand_ins.load_to_read

    def _ping(self, request: Request) -> PingReply:
        self._stops.is_late = self._is_late(request)
        if not self._stops.is_late:  # a late ping does not show that the server is there
            self._lease.renew(request.number("lease_s", 0.0))
        self._outbox.begin_pieces(int(request.number("window_bytes", 0.0)))
        if request.has("latch_count"):
            self._stops.latch.mirror(
                LatchState(
                    is_set=bool(request.number("latch_set", 0.0)),
                    count=int(request.number("latch_count", 0.0)),
                    by=request.text("latch_by", ""),
                    reason=request.text("latch_reason", ""),
                )
            )
        now_s = time.monotonic()
        idle_s = round(now_s - self._loop.last_turn, 6)
        sent_ns = request.number("sent_ns", 0)
        return {"ros_idle_s": idle_s, "now_ns": time.time_ns(), "sent_ns": sent_ns, "steady_s": now_s}

    def _is_late(self, request: Request) -> bool:
        """Return whether a ping left the server long ago: `heard_s` is the time of our last answer
        that the server had received.
        """
        if not request.has("heard_s"):  # on one machine there is no delay
            return False
        return time.monotonic() - max(request.number("heard_s"), self._greeted_s) > LATE_S

    def _policy(self, request: Request) -> PolicyReply:
        return {"digest": self._limiter.take(request.body)}

    def _spent(self, request: Request) -> Empty:
        self._limiter.resume(request.body)
        return {}


def _calls_what_acts(request: Request) -> bool:
    """Return whether a request calls a service that does more than read or stop: then a stop
    or the latch holds it back.

    Whether a request with `brakes` really brakes is checked where it is decoded, before it is sent.
    """
    if request.op != "call" or request.flag("brakes"):
        return False
    return meaning(request.text("service"), request.text("type")).verb not in ("read", "cancel")


if __name__ == "__main__":
    main()
