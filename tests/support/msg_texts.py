"""The definitions of types as files of recordings have them."""

from __future__ import annotations

from rosbags.typesys import Stores, get_typestore


def text_of(kind: str) -> str:
    """The definition of a type of ROS 2 Jazzy with those that it needs."""
    return get_typestore(Stores.ROS2_JAZZY).generate_msgdef(kind, ros_version=2)[0]
