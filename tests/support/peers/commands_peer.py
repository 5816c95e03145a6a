"""Independent rclpy nodes that the tests command: one JSON list per line in, one value per line out.

This process only imports ROS and forks: a peer for each socket that comes through the socket that is its stdin. The
peer enters ROS at once, so that others get to know its process. The first line, `[namespace, role, …]`, tells what it
becomes: roles are the functions below, each offers something under the namespace. Commands follow; ROS runs on threads
beside them. A peer leaves as a ROS node should when its socket is closed, and on SIGTERM.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from queue import Queue
from typing import Any, TextIO

import rclpy
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Twist
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import DescribeParameters, GetParameters, GetParameterTypes, ListParameters, SetParameters
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger
from test_msgs.action import Fibonacci, NestedMessage
from test_msgs.srv import BasicTypes

from support.leaving import leave_on_sigterm

STEP_S = 0.05
PATIENCE_S = 20.0


class Peer:
    """One process; its public methods are the commands."""

    def __init__(self, namespace: str) -> None:
        self.node = Node("peer", namespace=namespace)
        self.nodes = [self.node]
        self.group = ReentrantCallbackGroup()
        self._asking = MutuallyExclusiveCallbackGroup()
        self.counts: Counter[str] = Counter()
        self.released = threading.Event()
        self.velocities: list[tuple[float, float]] = []
        self._clients: dict[str, Any] = {}
        self._handles: dict[str, Any] = {}
        self._kept: list[Any] = []
        self.unspun: list[Node] = []
        self.untaken: dict[str, Service] = {}

    def keep(self, *entities: Any) -> None:
        self._kept += entities

    # ── commands ───────────────────────────────────────────────────────────────────────────────────────────────

    def count(self, name: str) -> int:
        """How many requests or goals have come."""
        return self.counts[name]

    def take(self, name: str) -> bool:
        """Whether a request has come to a service that never answers; the request is taken from its queue."""
        service = self.untaken[name]
        with service.handle:
            return service.handle.service_take_request(service.srv_type.Request)[1] is not None

    def answer(self, name: str) -> bool:
        """As `take`, and it is answered, with nothing in it."""
        service = self.untaken[name]
        with service.handle:
            _, header = service.handle.service_take_request(service.srv_type.Request)
            if header is not None:
                service.handle.service_send_response(service.srv_type.Response(), header.request_id)
        return header is not None

    def offer(self, role: str) -> None:
        """Offer one more role."""
        globals()[role](self)

    def driven(self) -> list[tuple[float, float]]:
        """The velocities that came, with the steady time of receipt."""
        return list(self.velocities)

    def send_goal(self, action: str, order: int) -> str:
        """Send a goal as any other client does; returns its id."""
        client = self._clients.setdefault(
            action, ActionClient(self.node, Fibonacci, action, callback_group=self._asking)
        )
        assert client.wait_for_server(timeout_sec=PATIENCE_S)
        handle = self._answer_of(lambda: client.send_goal_async(Fibonacci.Goal(order=order)))
        assert handle.accepted
        goal_id = bytes(handle.goal_id.uuid).hex()
        self._handles[goal_id] = handle
        return goal_id

    def _answer_of(self, ask: Callable[[], Any]) -> Any:
        """Ask in the turn of the action client's callbacks: rclpy drops an answer that comes before it has noted the
        request, which another thread may be too late for.
        """
        asked: Queue[Any] = Queue()
        timer = self.node.create_timer(0.0, lambda: (timer.cancel(), asked.put(ask())), callback_group=self._asking)
        future = asked.get(timeout=PATIENCE_S)
        self.node.destroy_timer(timer)
        return _wait(future)

    def result(self, goal_id: str) -> list[Any]:
        """The status and the sequence of a goal sent from here."""
        answer = self._answer_of(self._handles[goal_id].get_result_async)
        return [answer.status, list(answer.result.sequence)]

    def cancel(self, goal_id: str) -> int:
        """Cancel a goal sent from here; returns the code."""
        return self._answer_of(self._handles[goal_id].cancel_goal_async).return_code

    def call(self, service: str, data: bool) -> str:
        """Call a SetBool service of somebody else."""
        client = self.node.create_client(SetBool, service)
        assert client.wait_for_service(timeout_sec=PATIENCE_S)
        return _wait(client.call_async(SetBool.Request(data=data))).message

    def reaches(self, service: str) -> bool:
        """Whether a SetBool service of somebody else answers; if so, it and this process know each other."""
        client, answered = self.node.create_client(SetBool, service), threading.Event()
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline and not answered.is_set():
            if client.wait_for_service(timeout_sec=1.0):
                client.call_async(SetBool.Request()).add_done_callback(lambda _: answered.set())
                answered.wait(1.0)
        return answered.is_set()

    def release(self) -> None:
        """Let the goals of `held` succeed."""
        self.released.set()


def _wait(future: Any, within_s: float = PATIENCE_S) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(within_s), "no answer"
    return future.result()


# ── roles ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def services(peer: Peer) -> None:
    """`switch` answers at once, `slow` after `float64_value` seconds, `fatal` never: the process dies of it."""

    def switch(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        peer.counts["switch"] += 1
        response.success, response.message = request.data, f"asked {request.data}"
        return response

    def slow(request: BasicTypes.Request, response: BasicTypes.Response) -> BasicTypes.Response:
        peer.counts["slow"] += 1
        time.sleep(request.float64_value)
        response.string_value, response.int64_value = request.string_value, request.int64_value
        return response

    def serial(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        time.sleep(0.03)
        return switch(request, response)

    def fatal(_request: SetBool.Request, _response: SetBool.Response) -> Any:
        os._exit(1)

    for kind, name, callback in ((SetBool, "switch", switch), (BasicTypes, "slow", slow), (SetBool, "fatal", fatal)):
        peer.keep(peer.node.create_service(kind, name, callback, callback_group=peer.group))
    peer.keep(peer.node.create_service(SetBool, "serial", serial, callback_group=MutuallyExclusiveCallbackGroup()))


def changed(peer: Peer) -> None:
    """A service of another type where `services` has its switch."""
    peer.keep(peer.node.create_service(Trigger, "switch", lambda _request, response: response))


def actions(peer: Peer) -> None:
    """`count` counts to its order, one feedback a step; the others each do one thing that goes wrong."""
    _action(peer, "count", _count)
    _action(peer, "reject", _count, goal=GoalResponse.REJECT)
    _action(peer, "abort", _abort)
    _action(peer, "refuse_cancel", _count, cancel=CancelResponse.REJECT)
    _action(peer, "refuse_once", _until_refused, cancel=CancelResponse.REJECT)
    _action(peer, "go_on", _go_on, cancel=CancelResponse.REJECT)
    _action(peer, "ignore_cancel", _ignore_cancel)
    _action(peer, "held", _held)
    _action(peer, "hesitate", _count, hesitation_s=1.0)
    _action(peer, "burst", _burst, feedback_pub_qos_profile=QoSProfile(depth=100))  # it forgets none itself
    _action(peer, "forget", _burst, result_timeout=1)
    _action(peer, "fatal", lambda _peer, _goal: os._exit(1))


def raw(peer: Peer) -> None:
    """An action made by hand: it accepts goals, never tells a result, and refuses to cancel with a code of its own."""

    def refuse(_request: Any, response: Any) -> Any:
        response.return_code = CancelGoal.Response.ERROR_REJECTED
        return response

    def accept(_request: Any, response: Any) -> Any:
        peer.counts["raw"] += 1
        response.accepted = True
        return response

    impl, node = Fibonacci.Impl, Node("raw_results", namespace=peer.node.get_namespace())
    peer.unspun.append(node)
    peer.untaken["raw"] = node.create_service(impl.GetResultService, "raw/_action/get_result", _unspun)
    peer.keep(
        peer.node.create_publisher(impl.FeedbackMessage, "raw/_action/feedback", 10),
        peer.node.create_service(impl.SendGoalService, "raw/_action/send_goal", accept),
        peer.node.create_service(CancelGoal, "raw/_action/cancel_goal", refuse),
    )


def late(peer: Peer) -> None:
    """An action whose status tells at once that it has accepted a goal, and whose answer takes a minute."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    status = peer.node.create_publisher(GoalStatusArray, "late/_action/status", latched)

    def accept(request: Any, response: Any) -> Any:
        told = GoalStatus(status=GoalStatus.STATUS_EXECUTING)
        told.goal_info.goal_id, told.goal_info.stamp.sec = request.goal_id, 7
        status.publish(GoalStatusArray(status_list=[told]))
        time.sleep(60.0)
        response.accepted = True
        return response

    impl = Fibonacci.Impl
    peer.keep(
        status,
        peer.node.create_publisher(impl.FeedbackMessage, "late/_action/feedback", 10),
        peer.node.create_service(impl.SendGoalService, "late/_action/send_goal", accept),
        peer.node.create_service(impl.GetResultService, "late/_action/get_result", _unspun),
        peer.node.create_service(CancelGoal, "late/_action/cancel_goal", _unspun),
    )


def lossy(peer: Peer) -> None:
    """An action whose goals succeed at once, and whose first answer to a question for the result is lost."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    status = peer.node.create_publisher(GoalStatusArray, "lossy/_action/status", latched)

    def accept(request: Any, response: Any) -> Any:
        told = GoalStatus(status=GoalStatus.STATUS_SUCCEEDED)
        told.goal_info.goal_id = request.goal_id
        status.publish(GoalStatusArray(status_list=[told]))
        response.accepted = True
        return response

    def answer(_request: Any, response: Any) -> Any:
        response.status, response.result.sequence = GoalStatus.STATUS_SUCCEEDED, [7]
        return response

    impl = Fibonacci.Impl
    results = peer.node.create_service(impl.GetResultService, "lossy/_action/get_result", answer)
    send_response = results.send_response

    def send_all_but_the_first(response: Any, header: Any) -> None:
        peer.counts["lossy"] += 1
        if peer.counts["lossy"] > 1:
            send_response(response, header)

    results.send_response = send_all_but_the_first
    peer.keep(
        status,
        results,
        peer.node.create_publisher(impl.FeedbackMessage, "lossy/_action/feedback", 10),
        peer.node.create_service(impl.SendGoalService, "lossy/_action/send_goal", accept),
        peer.node.create_service(CancelGoal, "lossy/_action/cancel_goal", _unspun),
    )


def counting(peer: Peer) -> None:
    """Only the action `count`: starts quickly."""
    _action(peer, "count", _count)


def nested(peer: Peer) -> None:
    """An action whose goal has messages inside."""

    def accept(_goal: Any) -> GoalResponse:
        peer.counts["nested"] += 1
        return GoalResponse.ACCEPT

    def execute(goal: Any) -> Any:
        goal.succeed()
        return NestedMessage.Result()

    peer.keep(ActionServer(peer.node, NestedMessage, "nested", execute, goal_callback=accept))


def _action(
    peer: Peer,
    name: str,
    execute: Any,
    *,
    goal: Any = None,
    cancel: Any = None,
    hesitation_s: float = 0.0,
    **options: Any,
) -> None:
    def judge(_request: Any) -> Any:
        peer.counts[name] += 1
        time.sleep(hesitation_s)
        if goal is GoalResponse.REJECT:
            peer.node.get_logger().warn(f"{name}: the motors are disabled")
        return goal or GoalResponse.ACCEPT

    def judge_cancel(_request: Any) -> Any:
        peer.counts[f"{name} cancel"] += 1
        return cancel or CancelResponse.ACCEPT

    server = ActionServer(
        peer.node,
        Fibonacci,
        name,
        lambda handle: execute(peer, handle),
        goal_callback=judge,
        cancel_callback=judge_cancel,
        callback_group=peer.group,
        **options,
    )
    peer.keep(server)


def _count(peer: Peer, goal: Any) -> Fibonacci.Result:
    done: list[int] = []
    peer.counts["count executing"] += 1
    for number in range(goal.request.order):
        if goal.is_cancel_requested:
            goal.canceled()
            peer.counts["canceled"] += 1
            return Fibonacci.Result(sequence=done)
        done.append(number)
        goal.publish_feedback(Fibonacci.Feedback(sequence=done))
        time.sleep(STEP_S)
    goal.succeed()
    return Fibonacci.Result(sequence=done)


def _go_on(peer: Peer, goal: Any) -> Fibonacci.Result:
    """Counts until it was asked to end, which is refused, and a second more: the refusal comes before the result."""
    done: list[int] = []

    def step() -> None:
        done.append(len(done))
        goal.publish_feedback(Fibonacci.Feedback(sequence=done))
        time.sleep(STEP_S)

    while not peer.counts["go_on cancel"] and len(done) < goal.request.order:
        step()
    for _ in range(20):
        step()
    goal.succeed()
    return Fibonacci.Result(sequence=done)


def _abort(_peer: Peer, goal: Any) -> Fibonacci.Result:
    goal.abort()
    return Fibonacci.Result(sequence=[6])


def _until_refused(peer: Peer, goal: Any) -> Fibonacci.Result:
    """Succeeds as soon as every goal was asked to end, and refused to."""
    _wait_until(lambda: peer.counts["refuse_once cancel"] >= peer.counts["refuse_once"])
    goal.succeed()
    return Fibonacci.Result(sequence=[5])


def _held(peer: Peer, goal: Any) -> Fibonacci.Result:
    peer.released.wait(PATIENCE_S)
    goal.succeed()
    return Fibonacci.Result(sequence=[3])


def _wait_until(condition: Any) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(STEP_S)


def _ignore_cancel(_peer: Peer, goal: Any) -> Fibonacci.Result:
    _wait_until(lambda: goal.is_cancel_requested)
    goal.succeed()
    return Fibonacci.Result(sequence=[4])


def _burst(_peer: Peer, goal: Any) -> Fibonacci.Result:
    for number in range(goal.request.order):
        goal.publish_feedback(Fibonacci.Feedback(sequence=[number]))
    goal.succeed()
    return Fibonacci.Result(sequence=[goal.request.order])


def watch(peer: Peer) -> None:
    """Keep the velocities of `cmd_vel`."""

    def note(message: Twist) -> None:
        peer.velocities.append((time.monotonic(), message.linear.x))

    peer.keep(peer.node.create_subscription(Twist, "cmd_vel", note, 50))


def tuned(peer: Peer) -> None:
    """A node with parameters of every type, and one that allows undeclared ones."""
    node = Node("tuned", namespace=peer.node.get_namespace())
    limited = ParameterDescriptor(
        description="Fastest speed [m/s]", floating_point_range=[FloatingPointRange(from_value=0.0, to_value=2.0)]
    )
    stepped = ParameterDescriptor(integer_range=[IntegerRange(from_value=0, to_value=10, step=5)])
    node.declare_parameter("speed", 0.5, limited)
    node.declare_parameter("steps", 5, stepped)
    node.declare_parameter("serial", "A-1", ParameterDescriptor(read_only=True))
    node.declare_parameter("enabled", True)
    node.declare_parameter("label", "3")
    node.declare_parameter("big", 2**62 + 1)
    node.declare_parameter("pid.p", 1.5)
    node.declare_parameter("octets", [b"\x01", b"\xff"])
    node.declare_parameter("flags", [True, False])
    node.declare_parameter("counts", [1, 2**60])
    node.declare_parameter("gains", [0.5, float("inf")])
    node.declare_parameter("names", ["a", "b"])
    node.declare_parameter("any", 1, ParameterDescriptor(dynamic_typing=True))

    def judge(parameters: list[Any]) -> SetParametersResult:
        peer.counts["set"] += 1
        if any(parameter.name == "label" and parameter.value == "bad" for parameter in parameters):
            return SetParametersResult(successful=False, reason="the label is bad, says the node")
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(judge)
    peer.nodes += [node, Node("open", namespace=peer.node.get_namespace(), allow_undeclared_parameters=True)]


def unset(peer: Peer) -> None:
    """Nodes with parameters that are declared and not set; `terse` answers for what it likes, as some of C++ do, and
    `slow_to_set` takes its time for a value.
    """
    namespace = peer.node.get_namespace()
    mapper = Node("mapper", namespace=namespace)
    mapper.declare_parameter("a_first", Parameter.Type.INTEGER)
    for number in range(20):
        mapper.declare_parameter(f"gain_{number:02d}", float(number))
    mapper.declare_parameter("gain_07_name", Parameter.Type.STRING, ParameterDescriptor(description="Of the seventh"))
    mapper.declare_parameter("loose", None, ParameterDescriptor(dynamic_typing=True))
    mapper.declare_parameter("plugins", Parameter.Type.STRING_ARRAY)
    mapper.declare_parameter("untyped_list", [])
    mapper.declare_parameter("z_last", Parameter.Type.BOOL, ParameterDescriptor(read_only=True))
    terse = Node("terse", namespace=namespace, start_parameter_services=False)
    values = {"here": ParameterValue(type=2, integer_value=7), "there": ParameterValue(type=3, double_value=0.5)}

    def names(_request: Any, response: Any) -> Any:
        response.result.names = ["gone", "here", "there"]
        return response

    def known(request: Any, response: Any) -> Any:
        response.values = [values[name] for name in request.names if name in values]
        return response

    def types(request: Any, response: Any) -> Any:
        response.types = bytes(4 if name == "gone" else values[name].type for name in request.names)
        return response

    for kind, service, answer in (
        (ListParameters, "list_parameters", names),
        (GetParameters, "get_parameters", known),
        (GetParameterTypes, "get_parameter_types", types),
        (DescribeParameters, "describe_parameters", lambda _request, response: response),
    ):
        peer.keep(terse.create_service(kind, f"terse/{service}", answer))
    one_at_a_time(peer)
    slow = Node("slow_to_set", namespace=namespace)
    slow.declare_parameter("gain", 1.0)

    def wait_for_release(_parameters: Any) -> SetParametersResult:
        peer.released.wait(PATIENCE_S)
        return SetParametersResult(successful=True)

    slow.add_on_set_parameters_callback(wait_for_release)
    peer.nodes += [mapper, terse, slow]


def one_at_a_time(peer: Peer) -> None:
    """A node that answers for one name, and to more than one nothing, as micro-ROS with little memory; one of its
    parameters it never takes.
    """
    node = Node("one_at_a_time", namespace=peer.node.get_namespace(), start_parameter_services=False)
    values = {
        "gain": ParameterValue(type=3, double_value=1.0),
        "mode": ParameterValue(type=4, string_value="slow"),
        "offset": ParameterValue(type=2, integer_value=1),
    }

    def names(_request: Any, response: Any) -> Any:
        response.result.names = list(values)
        return response

    def get(request: Any, response: Any) -> Any:
        response.values = [values[name] for name in request.names] if len(request.names) == 1 else []
        return response

    def take(request: Any, response: Any) -> Any:
        if len(request.parameters) == 1:
            (one,) = request.parameters
            if one.name == "mode":
                response.results = [SetParametersResult(successful=False, reason="only by hand")]
            else:
                values[one.name] = one.value
                response.results = [SetParametersResult(successful=True)]
        return response

    for kind, service, answer in (
        (ListParameters, "list_parameters", names),
        (GetParameters, "get_parameters", get),
        (GetParameterTypes, "get_parameter_types", lambda _request, response: response),
        (DescribeParameters, "describe_parameters", lambda _request, response: response),
        (SetParameters, "set_parameters", take),
    ):
        peer.keep(node.create_service(kind, f"one_at_a_time/{service}", answer))
    peer.nodes.append(node)


class Valve(LifecycleNode):
    """A lifecycle node whose activation fails the first time, and says why."""

    tries = 0

    def on_activate(self, state: Any) -> Any:
        self.tries += 1
        if self.tries == 1:
            self.get_logger().error("the valve sticks")
        return TransitionCallbackReturn.FAILURE if self.tries == 1 else super().on_activate(state)


def valve(peer: Peer) -> None:
    """The lifecycle node."""
    peer.nodes.append(Valve("valve", namespace=peer.node.get_namespace()))


def dumb(peer: Peer) -> None:
    """A node without parameter services, and one that never answers, its service `mute` included."""
    namespace = peer.node.get_namespace()
    peer.nodes.append(Node("dumb", namespace=namespace, start_parameter_services=False))
    deaf = Node("deaf", namespace=namespace)
    peer.untaken["mute"] = deaf.create_service(SetBool, "mute", _unspun)
    peer.untaken["state"] = deaf.create_service(GetState, "state", _unspun)
    peer.unspun.append(deaf)


def _unspun(_request: Any, _response: Any) -> Any:
    raise AssertionError("nobody spins this node")


# ── processes ──────────────────────────────────────────────────────────────────────────────────────────────────────


def main() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them here
    with socket.socket(fileno=0) as sockets:
        while descriptors := socket.recv_fds(sockets, 1, 1)[1]:
            if os.fork() == 0:
                break
            os.close(descriptors[0])
        else:
            return
    be_peer(socket.socket(fileno=descriptors[0]))


def be_peer(commands: socket.socket) -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    leave_on_sigterm(lambda: commands.shutdown(socket.SHUT_RD))
    spare = Node("spare", namespace=f"/spare{os.getpid()}", enable_rosout=False, start_parameter_services=False)
    with commands.makefile("rw") as lines:
        _say(lines, os.getpid())
        if line := lines.readline():
            _become_peer(lines, spare, *json.loads(line))
    spare.destroy_node()
    rclpy.try_shutdown()
    os._exit(0)  # whatever a callback is still busy with


def _become_peer(lines: TextIO, spare: Node, namespace: str, *roles: str) -> None:
    peer = Peer(namespace)
    for role in roles:
        peer.offer(role)
    peer.keep(peer.node.create_service(SetBool, "there", lambda _request, response: response))
    executor = MultiThreadedExecutor(num_threads=24)
    for node in peer.nodes:
        executor.add_node(node)
    spinning = threading.Thread(target=_spin, args=(executor,), daemon=True)
    spinning.start()
    spare.destroy_node()
    _say(lines, "ready")
    for line in lines:
        command, arguments = json.loads(line)
        _say(lines, getattr(peer, command)(**arguments))
    executor.shutdown(timeout_sec=0.5)
    spinning.join(1.0)
    for node in (*peer.nodes, *peer.unspun):
        for of_an_action in list(node.waitables):  # rclpy does not destroy these with the node, though they keep it
            of_an_action.destroy()
        if isinstance(node, LifecycleNode):
            node._state_machine.destroy_when_not_in_use()
        node.destroy_node()


def _say(lines: TextIO, value: Any) -> None:
    print(json.dumps(value), file=lines, flush=True)


def _spin(executor: MultiThreadedExecutor) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
