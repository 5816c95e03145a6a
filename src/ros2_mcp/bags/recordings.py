"""Group the files of a folder into recordings: by `metadata.yaml`, or by names that differ in `_N` alone."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from ros2_mcp.bags.rosbag2 import METADATA, FolderFacts, read_metadata
from ros2_mcp.model.errors import BadData, BadInput, NotFound
from ros2_mcp.model.text import listed, named

SUFFIXES = (".mcap", ".db3", ".db3.zstd", ".mcap.zstd")
ROS_1_START = b"#ROSBAG V"
"""The first bytes of a ROS 1 bag."""
_STEM = re.compile(r"(?P<stem>.*?)(?:_\d+)?(?:\.mcap|\.db3)(?:\.zstd)?", re.DOTALL)
_OF_RING = re.compile(r"(?P<stem>box)_\d{8}T\d{6}_\d{9}_0\.mcap")
"""The files of a black box, whose names have their start times (`ring.py`)."""
_MOST_NAMED = 10
"""Most recordings that an error names."""


def recordings_in(folder: Path, *, as_whole: bool = True) -> list[Path]:
    """Return the recordings of a folder: the folder itself if all its files form one recording; otherwise each
    recording's path.

    Without `as_whole` the folder itself is never returned, for a folder that only contains recordings. A recording of
    several files has the name that these have in common, without number and suffix.
    """
    files = _in_order(folder)
    stems = {stem_of(path): path for path in files}
    if as_whole and len(stems) == 1:
        return [folder]
    of_folder = _of_metadata(folder, files) if as_whole and files else []
    found = [folder] if of_folder else []
    for stem in stems:
        parts = [path for path in files if stem_of(path) == stem]
        if parts[0] in of_folder:
            continue
        whole = folder / stem
        found += [whole] if len(parts) > 1 and stem and not whole.exists() else parts
    return found


def files_of(path: Path) -> list[Path]:
    """Return the files of a recording, in order.

    Raises:
        NotFound: if there is no recording at that path.
        BadInput: if the folder has several recordings.
        BadData: if the path cannot be read.
    """
    try:
        if path.is_file():
            return [path]
        found = _in_folder(path) if path.is_dir() else _of_stem(path)
    except OSError as error:
        raise BadData(f"{path.name} cannot be read: {error.strerror}.") from error
    if not found and path.is_dir():
        raise NotFound(f"{path.name} is not a bag: it has no .mcap or .db3 file.")
    if not found:
        raise NotFound(f"There is no bag {path.name}.")
    return found


def is_recording(path: Path) -> bool:
    """Return whether a recording exists at `path`: a file, a folder, or files with that name and a number."""
    try:
        return path.exists() or bool(_of_stem(path))
    except OSError:
        return False


def stem_of(path: Path) -> str:
    """Return the name of a file without its suffix and number: `run` for `run_2.mcap`."""
    match = _OF_RING.fullmatch(path.name) or _STEM.fullmatch(path.name)
    return match["stem"] if match else path.name


def order_of(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that compares numbers as numbers: `run_2.mcap` comes before `run_10.mcap`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def of_ros_1(path: Path) -> str:
    """Return a sentence that names a ROS 1 bag and how to convert it; empty for other files."""
    with path.open("rb") as file:
        if file.read(len(ROS_1_START)) != ROS_1_START:
            return ""
    convert = f"rosbags-convert --src {path.name} --dst {path.stem}"
    return f"{named(path.name)} is a recording of ROS 1. Convert it: {convert} (pip install rosbags)."


def foreign_in(folder: Path) -> list[str]:
    """Return a sentence for each ROS 1 bag in a folder."""
    found: list[str] = []
    with suppress(OSError):
        for path in sorted(folder.glob("*.bag")):
            with suppress(OSError):
                found.append(of_ros_1(path))
    return list(filter(None, found))


def _in_folder(folder: Path) -> list[Path]:
    """Return the files of the one recording of a folder; raises `BadInput` if there are several."""
    files = _in_order(folder)
    if len({stem_of(path) for path in files}) <= 1:
        return files
    if of_folder := _of_metadata(folder, files):
        return of_folder
    found = [f"{folder.name}/{path.name}" for path in recordings_in(folder)]
    raise BadInput(
        f"{named(folder.name)} has {len(found)} recordings: nothing says that they are one.",
        f"Name one of them: {listed(found, _MOST_NAMED)}.",
    )


def _of_metadata(folder: Path, files: list[Path]) -> list[Path]:
    """Return the files that `metadata.yaml` lists, compressed or not; empty without a readable `metadata.yaml`."""
    facts = read_metadata(folder) if (folder / METADATA).exists() else ""
    if not isinstance(facts, FolderFacts):
        return []
    stems = {stem_of(Path(name)) for name in facts.files}
    return [path for path in files if stem_of(path) in stems]


def _of_stem(path: Path) -> list[Path]:
    """Return the files whose name is that of the path plus a number."""
    if not path.name or not path.parent.is_dir():
        return []
    return [file for file in _in_order(path.parent) if stem_of(file) == path.name and file.name != path.name]


def _in_order(folder: Path) -> list[Path]:
    return sorted((path for path in folder.iterdir() if path.name.endswith(SUFFIXES) and path.is_file()), key=order_of)
