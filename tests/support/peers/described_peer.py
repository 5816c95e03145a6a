"""A node with types that are not installed elsewhere, and two services of which it publishes all events."""

import threading

import rclpy
from geometry_msgs.msg import TransformStamped
from mavros_msgs.msg import ExtendedState, State, Waypoint, WaypointList
from mavros_msgs.srv import CommandBool
from rclpy.qos import qos_profile_system_default
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from support.leaving import leave_on_sigterm

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
    told = node.get_clock(), qos_profile_system_default, ServiceIntrospectionState.CONTENTS
    for kind, name, answer in ((SetBool, "/grip", grip), (CommandBool, "/arm", arm)):
        node.create_service(kind, name, answer).configure_introspection(*told)
        clients.append(node.create_client(kind, name))
        clients[-1].configure_introspection(*told)

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

    told_to_end = threading.Event()
    leave_on_sigterm(told_to_end.set)
    node.create_timer(PERIOD_S, tick)
    print("ready", flush=True)
    while not told_to_end.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
