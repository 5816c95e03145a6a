"""The folder of a rosbag2 recording: `metadata.yaml` beside the files."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from ros2_mcp.bags.stored import StoredTopic
from ros2_mcp.model.text import quoted

METADATA = "metadata.yaml"
NOT_CLOSED = f"{METADATA} is missing: the recording was not closed."
VERSION = 8
"""Version of the metadata: the version of Iron; its integers for QoS are read by every later distribution, too."""


@dataclass(slots=True)
class FilePart:
    """One file of a recording: Unix times (ns) of its first and last message (0: none), number and bytes of messages.

    The bytes are those of the messages only, without the file's index.
    """

    name: str
    start_ns: int = 0
    end_ns: int = 0
    count: int = 0
    bytes: int = 0


@dataclass(frozen=True, slots=True)
class FolderFacts:
    """Contents of a `metadata.yaml`: files in order, number of messages, and `file` or `message` if compressed."""

    files: Sequence[str]
    count: int
    compression_mode: str


def write_metadata(folder: Path, topics: Sequence[tuple[StoredTopic, str]], files: Sequence[FilePart]) -> None:
    """Write `metadata.yaml` atomically; each of `topics` comes with its type hash.

    Raises:
        OSError: if the folder cannot be written.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    text = io.StringIO()
    yaml.dump({"rosbag2_bagfile_information": _information(topics, files)}, text)  # pyright: ignore[reportUnknownMemberType]
    draft = folder / f".{METADATA}"
    with draft.open("w", encoding="utf-8") as file:
        file.write(text.getvalue().strip() + "\n")
        file.flush()
        os.fsync(file.fileno())
    draft.replace(folder / METADATA)


def read_metadata(folder: Path) -> FolderFacts | str:
    """Return the contents of `metadata.yaml`, or a sentence why it cannot be read."""
    try:
        loaded = YAML(typ="safe", pure=True).load((folder / METADATA).read_text(encoding="utf-8"))  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
        raw = cast("dict[str, Any]", loaded)["rosbag2_bagfile_information"]
        files = [str(path) for path in raw["relative_file_paths"]]
        return FolderFacts(files, int(raw["message_count"]), str(raw.get("compression_mode") or "").lower())
    except FileNotFoundError:
        return NOT_CLOSED
    except (OSError, YAMLError, UnicodeDecodeError, ValueError, TypeError, KeyError, AttributeError) as error:
        return f"{METADATA} cannot be read: {quoted((str(error) or type(error).__name__).splitlines()[0])}"


def _information(topics: Sequence[tuple[StoredTopic, str]], files: Sequence[FilePart]) -> dict[str, Any]:
    timed = [part for part in files if part.count]
    start = min((part.start_ns for part in timed), default=0)
    end = max((part.end_ns for part in timed), default=0)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(part.count for part in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": topic.serialization,
                    "offered_qos_profiles": topic.qos,
                    "type_description_hash": type_hash,
                },
                "message_count": topic.count or 0,
            }
            for topic, type_hash in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in files],
        "files": [
            {
                "path": part.name,
                "starting_time": {"nanoseconds_since_epoch": part.start_ns},
                "duration": {"nanoseconds": part.end_ns - part.start_ns},
                "message_count": part.count,
            }
            for part in files
        ],
        "custom_data": None,
        "ros_distro": "unknown",
    }
