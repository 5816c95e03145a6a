"""A Data Black Box of either generation, with its traps, on memory instead of InfluxDB: `box_peer.py 1`.

Every topic holds ten messages a second apart, from 2026-01-01T00:00:00.25Z on, but `/kept/many` 5,000 of them and
`/kept/recent` ten that end now.
"""

from __future__ import annotations

import base64
import calendar
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from lora_msgs.msg import EUI64, E5GenericMessage, FullDateTime, GpsDeviceData, MicroPublisher
from lora_msgs.srv import GetMessages
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState, Imu, JointState, LaserScan, NavSatFix
from std_msgs.msg import Bool, Float64, String, UInt8MultiArray
from wisevision_msgs.srv import InfluxGetMessages

BEGINNING_NS = calendar.timegm((2026, 1, 1, 0, 0, 0)) * 10**9 + 250_000_000
SECOND_NS = 10**9


def of_type(kind: str, number: int):
    made = {
        "String": lambda: String(data=f"grüße {number}"),
        "Bool": lambda: Bool(data=bool(number % 2)),
        "Float64": lambda: Float64(data=number / 3),
        "UInt8MultiArray": lambda: UInt8MultiArray(data=bytes(range(number))),
        "Twist": Twist,
        "PoseStamped": PoseStamped,
        "Odometry": Odometry,
        "Imu": Imu,
        "BatteryState": lambda: BatteryState(voltage=24.0 - number, cell_voltage=[float("nan")] * 3),
        "JointState": lambda: JointState(name=["a", "b"], position=[0.5, number]),
        "LaserScan": lambda: LaserScan(ranges=[float(number)] * 400),
    }
    message = made[kind]()
    if kind == "Twist":
        message.linear.x = number / 7
    elif kind in ("PoseStamped", "Odometry", "Imu"):
        message.header.stamp.sec, message.header.frame_id = number, "map"
    return message


KINDS = [
    "String",
    "Bool",
    "Float64",
    "UInt8MultiArray",
    "Twist",
    "PoseStamped",
    "Odometry",
    "Imu",
    "BatteryState",
    "JointState",
]


def type_name(message) -> str:
    return f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"


def stored() -> dict:
    """Topic without slash → (type, [(Unix ns, message)])."""
    topics = {f"kept/{kind}": [(BEGINNING_NS + i * SECOND_NS, of_type(kind, i)) for i in range(10)] for kind in KINDS}
    topics["kept/many"] = [(BEGINNING_NS + i * SECOND_NS, of_type("LaserScan", i)) for i in range(5000)]
    now_ns = time.time_ns()
    topics["kept/recent"] = [(now_ns - (9 - i) * SECOND_NS, of_type("Float64", i)) for i in range(10)]
    return topics


SPECIAL = {
    "std_msgs/Int32": ("int32_msgs", [-(2**31), 0, 7]),
    "lora_msgs/MicroPublisher": (
        "micro_publisher_data",
        [MicroPublisher(sensors_generic_data=[E5GenericMessage(name="t", value=1.5)], voltage=3.5, percentage=80)],
    ),
    "wisevision_msgs/GpsDevicesPublisher": (
        "gps_devices_data",
        [
            GpsDeviceData(
                device_eui=EUI64(data=list(range(8))),
                device_name="tag",
                nav_value=NavSatFix(latitude=52.25),
                is_moving=True,
            )
        ],
    ),
}


def moment(unix_ns: int) -> FullDateTime:
    t = time.gmtime(unix_ns // SECOND_NS)
    return FullDateTime(
        year=t.tm_year,
        month=t.tm_mon,
        day=t.tm_mday,
        hour=t.tm_hour,
        minute=t.tm_min,
        second=t.tm_sec,
        nanosecond=unix_ns % SECOND_NS,
    )


def unix_ns(given: FullDateTime) -> int:
    whole = calendar.timegm((given.year, given.month, given.day, given.hour, given.minute, given.second))
    return whole * SECOND_NS + given.nanosecond


def chosen(request, messages):
    """The first N of the range; raises as InfluxDB refuses a query with one end of a range only."""
    nothing = FullDateTime()
    open_ends = [end == nothing for end in (request.time_start, request.time_end)]
    if any(open_ends) and not all(open_ends):
        raise ValueError("error parsing query: found '0000-00-00T00:00:00Z'")
    if not all(open_ends):
        start, end = unix_ns(request.time_start), unix_ns(request.time_end)
        messages = [each for each in messages if start <= each[0] <= end]
    return messages[: request.number_of_msgs or None]


class Box:
    def __init__(self) -> None:
        self.topics = stored()

    def first(self, request, response):
        if request.topic_name == "kept/broken":
            response.error_message = "HTTP request error: Couldn't connect to server"
            return response
        if request.topic_name == "kept/torn":
            response.data = b"\x00\x00\x00\x08\x00\x01\x00\x00\x05\x00\x00\x00\x00\x00"
            response.timestamps = [moment(BEGINNING_NS)]
            return response
        if request.message_type in SPECIAL and request.topic_name == "kept/special":
            name, values = SPECIAL[request.message_type]
            setattr(response, name, values)
            response.timestamps = [moment(BEGINNING_NS + i * SECOND_NS) for i in range(len(values))]
            return response
        if request.message_type not in (*SPECIAL, "any"):
            response.error_message = f"Unknown message type: {request.message_type}"
            return response
        if request.message_type == "any":
            try:
                found = chosen(request, self.topics.get(request.topic_name, []))
            except ValueError as error:
                response.error_message = str(error)
                return response
            bodies = [serialize_message(message) for _, message in found]
            response.data = b"".join(len(body).to_bytes(4, "big") + body for body in bodies)
            response.timestamps = [moment(at_ns) for at_ns, _ in found]
        return response

    def second(self, request, response):
        if request.bucket_name not in ("", "fleet"):
            response.error_message = f"bucket {request.bucket_name!r} not found"
            return response
        try:
            found = chosen(request, self.topics.get(request.topic_name.lstrip("/"), []))
        except ValueError as error:
            response.error_message = str(error)
            return response
        response.success = True
        response.messages = [base64.b64encode(serialize_message(message)).decode() for _, message in found]
        response.timestamps = [moment(at_ns) for at_ns, _ in found]
        response.message_type = type_name(found[0][1]) if found else ""
        return response


if __name__ == "__main__":
    rclpy.init()
    node = rclpy.create_node(f"data_black_box_{sys.argv[1]}")
    box = Box()
    if sys.argv[1] == "1":
        node.create_service(GetMessages, "/get_messages", box.first)
    else:
        node.create_service(InfluxGetMessages, "/get_messages", box.second)
    print("ready", flush=True)
    rclpy.spin(node)
