"""Decide, when a file is opened, what each of its channels contains: encoding, type name and definition."""

from __future__ import annotations

import re

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.model.text import named

_CDR = "cdr"
_JSON = "json"
_DEFINITION_ENCODINGS = ("ros2msg", "ros2idl")
_TYPE = re.compile(r"([A-Za-z]\w*)/(?:(msg|srv|action)/)?([A-Za-z]\w*)", re.ASCII)
_DDS_TYPE = re.compile(r"(\w+)::(msg|srv|action)::(?:dds_::(\w+)_|(\w+))", re.ASCII)
"""Type names as in DDS: `std_msgs::msg::dds_::String_`."""
_ROS_1 = ("ros1", "ros1msg")


def stored_topic(
    name: str, type_name: str, encoding: str, definition: str, *, serialization: str, qos: str = ""
) -> StoredTopic:
    """Return a topic, with names and encodings normalised from what the reader of a file found.

    Args:
        name: the topic's name, as in the file.
        type_name: the name of its type or schema; empty if the file has none.
        encoding: the format of the definition: `ros2msg`, `ros2idl`, `jsonschema`, `protobuf` and others.
        definition: the definition, or an empty string.
        serialization: the encoding of its messages: `cdr`, `json`, `protobuf`, `ros1` and others.
        qos: rosbag2's text with the QoS of the publishers.
    """
    if serialization == _CDR and encoding not in _ROS_1 and type_name:
        if encoding not in _DEFINITION_ENCODINGS:
            encoding, definition = "", ""
        return StoredTopic(name, _ros_type(type_name), None, encoding, definition, qos, serialization)
    if serialization == _JSON:
        is_schema = encoding == "jsonschema"
        encoding, definition = (encoding, definition) if is_schema else ("", "")
        title = f"{_JSON}:{type_name or name}"  # without a schema, topics have nothing in common but JSON
        return StoredTopic(name, title, None, encoding, definition, qos, serialization, "json")
    title = ":".join(filter(None, (serialization or "unknown", type_name)))
    return StoredTopic(name, title, None, "", "", qos, serialization, "other")


def why_unreadable(topic: StoredTopic) -> tuple[str, str]:
    """Explain why the values of a topic of form `other` cannot be read.

    Returns:
        A sentence that names the encoding, and a hint.
    """
    if topic.serialization == _CDR:
        return "Its messages are CDR, but the recording does not name their type.", _MEASURED
    if not topic.serialization:
        return "Its messages are in no encoding that the recording names: read are CDR (ROS 2) and JSON.", _MEASURED
    type_name = topic.type.partition(":")[2]
    of_type = f" ({named(type_name)})" if type_name else ""
    what = f"Its messages{of_type} are encoded as {named(topic.serialization)}: read are CDR (ROS 2) and JSON."
    return what, f"{_CONVERTED} {_MEASURED}" if topic.serialization in _ROS_1 else _MEASURED


_MEASURED = "Their rate, sizes and times can be measured: ros2_topic_stats."
_CONVERTED = "Convert the ROS 1 recording: rosbags-convert --src NAME.bag --dst NAME."


def _ros_type(written: str) -> str:
    """Convert `std_msgs/String` or `std_msgs::msg::dds_::String_` to `std_msgs/msg/String`; keep other names."""
    if match := _DDS_TYPE.fullmatch(written):
        return f"{match[1]}/{match[2]}/{match[3] or match[4]}"
    match = _TYPE.fullmatch(written.replace(".", "/"))
    return f"{match[1]}/{match[2] or 'msg'}/{match[3]}" if match else written
