"""A node with types that are not installed elsewhere, and two services whose events it publishes.

It ends with its input.
"""

import contextlib
import sys
import threading

import rclpy
from geometry_msgs.msg import TransformStamped
from mavros_msgs.msg import ExtendedState, State, Waypoint, WaypointList
from mavros_msgs.srv import CommandBool
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_system_default
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

PERIOD_S = 0.1


def grip(request, response):
    response.success, response.message = request.data, "gripped"
    return response


def arm(request, response):
    response.success, response.result = request.value, 7
    return response


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("fcu")
    state, landed = node.create_publisher(State, "/state", 10), node.create_publisher(ExtendedState, "/landed", 10)
    waypoints, frames = (
        node.create_publisher(WaypointList, "/waypoints", 10),
        node.create_publisher(TFMessage, "/tf", 10),
    )
    clients = []
    for kind, name, answer in ((SetBool, "/grip", grip), (CommandBool, "/arm", arm)):
        service = node.create_service(kind, name, answer)
        service.configure_introspection(
            node.get_clock(), qos_profile_system_default, ServiceIntrospectionState.CONTENTS
        )
        clients.append(node.create_client(kind, name))

    def tick():
        state.publish(State(mode="GUIDED", armed=True))
        landed.publish(ExtendedState(landed_state=ExtendedState.LANDED_STATE_IN_AIR))
        waypoints.publish(WaypointList(current_seq=1, waypoints=[Waypoint(frame=3, x_lat=47.5)]))
        placed = TransformStamped()
        placed.header.frame_id, placed.child_frame_id, placed.transform.translation.x = "map", "base_link", 2.5
        placed.header.stamp = node.get_clock().now().to_msg()
        frames.publish(TFMessage(transforms=[placed]))
        for client, request in zip(clients, (SetBool.Request(data=True), CommandBool.Request(value=True)), strict=True):
            client.call_async(request)

    node.create_timer(PERIOD_S, tick)
    print("ready", flush=True)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.try_shutdown()), daemon=True).start()
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
