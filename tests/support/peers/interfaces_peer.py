"""Two nodes that talk with the interfaces of package `shop`; prints what arrived as one JSON object.

Run by test_interfaces_build.py in a Python of its own, with nothing but AMENT_PREFIX_PATH and PYTHONPATH set.
"""

import json
import time

import rclpy
from ament_index_python import get_resource
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import SingleThreadedExecutor
from shop.action import Fill
from shop.msg import Basket
from shop.srv import Count
from wares.msg import Item

PATIENCE_S = 30.0


def main():
    rclpy.init()
    shop, customer = rclpy.create_node("shop"), rclpy.create_node("customer")
    executor = SingleThreadedExecutor()
    executor.add_node(shop)
    executor.add_node(customer)
    seen = {
        "message": message(shop, customer, executor),
        "count": service(shop, customer, executor),
        "goal": action(shop, customer, executor),
        "index": sorted(get_resource("rosidl_interfaces", "shop")[0].split()),
        "default_label": Item().label,
    }
    print(json.dumps(seen))
    executor.shutdown()
    rclpy.shutdown()


def basket():
    made = Basket(few=[Item(label="pear", sizes=[0.5])], wide="é日")
    made.best.corners[1].x = 2.5
    made.header.frame_id = "table"
    made.markers[1].when.sec = 7
    return made


def message(shop, customer, executor):
    received = []
    customer.create_subscription(Basket, "baskets", received.append, 10)
    publisher = shop.create_publisher(Basket, "baskets", 10)
    spin_until(executor, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(basket())
    spin_until(executor, lambda: received)
    (got,) = received
    return {
        "equal": got == basket(),
        "x": got.best.corners[1].x,
        "sec": got.markers[1].when.sec,
        "big": got.big,
        "hash": str(customer.get_publishers_info_by_topic("baskets")[0].topic_type_hash),
    }


def service(shop, customer, executor):
    def count(request, response):
        response.count = len(request.basket.few)
        return response

    shop.create_service(Count, "count", count)
    client = customer.create_client(Count, "count")
    spin_until(executor, client.service_is_ready)
    return finished(executor, client.call_async(Count.Request(basket=basket()))).count


def action(shop, customer, executor):
    def fill(goal):
        feedback = Fill.Feedback()
        feedback.marker.when.sec = goal.request.n
        goal.publish_feedback(feedback)
        goal.succeed()
        return Fill.Result(basket=basket())

    server = ActionServer(shop, Fill, "fill", fill)
    client = ActionClient(customer, Fill, "fill")
    spin_until(executor, client.server_is_ready)
    feedback = []
    goal = finished(executor, client.send_goal_async(Fill.Goal(n=3), feedback_callback=feedback.append))
    result = finished(executor, goal.get_result_async())
    spin_until(executor, lambda: feedback)
    client.destroy()
    server.destroy()
    return {
        "feedback": feedback[0].feedback.marker.when.sec,
        "status": result.status,
        "equal": result.result.basket == basket(),
    }


def finished(executor, future):
    spin_until(executor, future.done)
    return future.result()


def spin_until(executor, condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("nothing arrived")
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main()
