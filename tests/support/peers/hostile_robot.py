"""A robot whose every text is hostile: topics, log, diagnostics, services, parameters, a lifecycle."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State, Transition, TransitionDescription
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_msgs.msg import Strings
from test_msgs.srv import BasicTypes

from support.hidden import HIDDEN
from support.leaving import leave_on_sigterm
from support.outlets import FORGED, hostile

PERIOD_S = 0.1
KEPT = hostile().replace("\0", "")  # rclpy cuts texts at a zero


class HostileRobot(Node):
    """Says what it has to say ten times a second; the parameter `kept` takes only the value that it has."""

    def __init__(self) -> None:
        super().__init__("hostile")
        kinds = {"text": String, "texts": Strings, "image": Image, "jpeg": CompressedImage}
        self.said = {name: self.create_publisher(kind, f"/hostile/{name}", 10) for name, kind in kinds.items()}
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Trigger, "/hostile/say", self.say)
        self.create_service(BasicTypes, "/hostile/basic", self.basic)
        described = ParameterDescriptor(description=hostile(), additional_constraints=hostile("tags"))
        self.declare_parameter("kept", KEPT, described)
        self.declare_parameter(f"name\n{FORGED}{HIDDEN['tags']}", [hostile("tags"), hostile("joiners")])
        self.add_on_set_parameters_callback(self.judge)
        self.create_service(GetState, "/hostile/get_state", self.state)
        self.create_service(GetAvailableTransitions, "/hostile/get_available_transitions", self.transitions)
        self.create_service(ChangeState, "/hostile/change_state", lambda _, response: response)
        self.classes = list(HIDDEN)
        self.create_timer(PERIOD_S, self.speak)

    def speak(self) -> None:
        self.classes.append(self.classes.pop(0))
        text = hostile(self.classes[0])
        self.said["text"].publish(String(data=text))
        self.said["texts"].publish(Strings(string_value=text, bounded_string_value="\u202e\u200b"))
        self.said["image"].publish(Image(height=1, width=1, step=1, encoding=text, data=b"\0"))
        self.said["jpeg"].publish(CompressedImage(format=text, data=b"no picture"))
        status = DiagnosticStatus(level=b"\2", name=text, message=text, hardware_id=text)
        status.values = [KeyValue(key=text, value=text)]
        self.diagnostics.publish(DiagnosticArray(status=[status]))
        self.get_logger().error(text.replace("\0", ""))

    def say(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, hostile()
        return response

    def basic(self, request: BasicTypes.Request, response: BasicTypes.Response) -> BasicTypes.Response:
        """Whether the text of the request is exactly the one that the parameter has."""
        response.bool_value, response.string_value = request.string_value == KEPT, hostile("isolates of direction")
        return response

    def judge(self, parameters: list[Any]) -> SetParametersResult:
        good = all(parameter.name != "kept" or parameter.value == KEPT for parameter in parameters)
        return SetParametersResult(successful=good, reason="" if good else hostile())

    def state(self, _: Any, response: GetState.Response) -> GetState.Response:
        response.current_state = State(id=2, label=hostile("soft hyphen"))
        return response

    def transitions(self, _: Any, response: GetAvailableTransitions.Response) -> GetAvailableTransitions.Response:
        label = TransitionDescription(transition=Transition(id=3, label=hostile("tags")))
        response.available_transitions = [label]
        return response


def main() -> None:
    rclpy.init(args=["--ros-args", "--disable-stdout-logs"])
    leave_on_sigterm(rclpy.try_shutdown)
    node = HostileRobot()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
