"""The bags of one server: the folders that it may write and read, and the open bags."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ros2_mcp.model.errors import BadInput, NotFound, RobotError
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import listed

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag
    from ros2_mcp.values.json_messages import RecordedCodec

RECORDINGS = Path("~/ros2-mcp/recordings")
_MOST_OPEN = 4
"""The most bags that stay open with their index and types, some MB each: enough to
compare two while two are recorded."""
_DEEPEST = 4
"""How many levels of folders are searched for bags: robot/day/run and one more. A home
folder has thousands of folders."""
BLACK_BOX = "black-box"
"""The name of the server's own black box among the bags."""
_BLACK_BOX_WORDS = ("black box", "black_box", "blackbox")


_MOST_FOREIGN = 5
"""The most recordings of ROS 1 that a list names."""
_MOST_TOLD = 10
"""The most lines about damage in one answer (ros2_bag_info has up to 50 for each file), and
the most bags that a hint names."""
_read_in_call: ContextVar[dict[Path, OpenedBag] | None] = ContextVar("_read_in_call", default=None)
"""The bags that are read on behalf of one call, in whatever task or thread, so that every reader reports damage."""


@dataclass(frozen=True, slots=True)
class OwnBag:
    """A bag that this server writes, or has written."""

    folder: Path
    is_growing: Callable[[], bool]
    now_ns: Callable[[], int]


class OpenedBag:
    """A bag that stays open, with the name by which it was requested. Only the thread
    that holds the lock may read it.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.bag: Bag | None = None
        self.lock = threading.Lock()
        self._path = path
        self._mark: tuple[int, int] | None = None
        self._codec: RecordedCodec | None = None
        self.read_as: dict[str, str] = {}
        """For each type read by an older definition: the distribution that defines it."""

    @property
    def codec(self) -> RecordedCodec:
        """The codec for the bag's messages. Types are compiled once and kept until the bag has
        another definition of one of them.
        """
        if self._codec is None:
            from ros2_mcp.values.definitions import Definitions
            from ros2_mcp.values.json_messages import RecordedCodec

            self._codec = RecordedCodec(Definitions())
            self.read_as = {}
        return self._codec

    @contextmanager
    def reading(self) -> Generator[Bag, None, None]:
        """Return the bag in its present state, for one thread to read. Raises the same errors as `Bag`.

        The bag is opened again when its files have changed; unchanged files are not read again.
        """
        from ros2_mcp.bags.bag import Bag  # imports mcap and YAML, a tenth of the time that all tools take to import

        if (noted := _read_in_call.get()) is not None:
            noted[self._path] = self
        with self.lock:
            mark = _mark(self._path)
            if self.bag is None or mark != self._mark:
                former, self.bag = self.bag, Bag(self._path, self.bag)
                self._mark = mark
                if former and _schemas(former).items() - _schemas(self.bag).items():
                    self._codec = None
            yield self.bag


class BagStore:
    """The folders that may be written (`record_dir`) and read (`bag_dir`, and what was recorded).

    `subject` is the recording that stands for the robot, if there is one; it may be read wherever it is. `own` are the
    bags that this server writes or has written, by name, in the order of their beginnings.
    """

    def __init__(self, record_dir: Path = RECORDINGS, bag_dir: Path | None = None, subject: Path | None = None) -> None:
        self.subject = subject.expanduser().resolve() if subject else None
        self.record_dir = record_dir.expanduser()
        self.bag_dir = bag_dir.expanduser() if bag_dir else self.record_dir
        self.own: dict[str, OwnBag] = {}
        self._opened: dict[Path, OpenedBag] = {}
        self._looking_up = threading.Lock()

    @property
    def subject_name(self) -> str:
        """The name of the recording that stands for the robot; empty if there is none."""
        return self.subject.name if self.subject else ""

    def writes(self, folder: Path, is_growing: Callable[[], bool], now_ns: Callable[[], int] = time.time_ns) -> None:
        """Register a bag that this server begins to write, with a function that says
        whether it still does, and its clock.

        Of bags that have ended only the folder is kept, because `is_growing` keeps a whole recording in memory.
        """
        for name, one in self.own.items():
            if not one.is_growing():
                self.own[name] = OwnBag(one.folder, _grows_no_more, time.time_ns)
        self.own[folder.name] = OwnBag(folder, is_growing, now_ns)

    async def close(self) -> None:
        """Close the open bags. Recordings in progress continue.

        A bag that a thread is reading, perhaps for a call that is over, is left to the end of the process: a descriptor
        that is closed meanwhile may belong to another file when it is read.
        """
        for opened in self._opened.values():
            if opened.lock.acquire(blocking=False):
                try:
                    if opened.bag:
                        opened.bag.close()
                finally:
                    opened.lock.release()
        self._opened.clear()

    @contextmanager
    def noting_damage(self) -> Generator[Callable[[], list[str]], None, None]:
        """Register the bags that are read inside the context. The yielded function returns what
        is damaged or missing in them.

        That is at most ten lines, and one with the number of others. It covers the known damage, which is all damage in
        the parts that were read.
        """
        noted: dict[Path, OpenedBag] = {}
        token = _read_in_call.set(noted)

        def told() -> list[str]:
            lines = [text for opened in noted.values() if opened.bag for text in self.problems_of(opened.bag)]
            more = len(lines) - _MOST_TOLD
            return [*lines[:_MOST_TOLD], *([f"{more} more: ros2_bag_info lists them."] if more > 0 else [])]

        try:
            yield told
        finally:
            _read_in_call.reset(token)

    def is_growing(self, bag: Bag) -> bool:
        """Return whether this server is recording the bag."""
        return self.recorded_until_ns(bag) is not None

    def recorded_until_ns(self, bag: Bag) -> int | None:
        """Return the present time, by the clock of the bag, if this server is recording it; else None."""
        own = list(self.own.values())  # a copy: this is a thread, and another one may begin a recording
        for written in own:
            if written.is_growing() and bag.path.resolve().is_relative_to(written.folder.resolve()):
                return written.now_ns()
        return None

    def problems_of(self, bag: Bag) -> list[str]:
        """Return what is damaged or missing in a bag. A missing end is no damage while the bag is being recorded."""
        problems = bag.problems
        if self.is_growing(bag):
            unfinished = set(bag.unfinished)
            problems = [text for text in problems if text not in unfinished]
        return problems

    def bag_names(self) -> dict[str, Path]:
        """Return every bag that may be read, by its name, which is its path below the folder."""
        from ros2_mcp.bags.recordings import recordings_in

        found: dict[str, Path] = {self.subject.name: self.subject} if self.subject else {}
        for root in self._roots:
            whole = root.resolve()
            for folder in _below(root)[0]:
                with suppress(OSError):
                    for path in recordings_in(folder, as_whole=folder != root):
                        if path.resolve().is_relative_to(whole):
                            found.setdefault(str(path.relative_to(root)), path)
        return found

    def not_listed(self) -> str:
        """Return sentences on recordings below the folders that cannot be read, and on
        folders that were not searched.
        """
        from ros2_mcp.bags.recordings import foreign_in

        foreign: dict[str, None] = {}
        unsearched: list[str] = []
        for root in self._roots:
            searched, deeper = _below(root)
            foreign |= dict.fromkeys(text for folder in searched for text in foreign_in(folder))
            unsearched += [str(folder.relative_to(root)) for folder in deeper]
        more = len(foreign) - _MOST_FOREIGN
        told = [*list(foreign)[:_MOST_FOREIGN], *([f"{more} more are of ROS 1, too."] if more > 0 else [])]
        if unsearched:
            told.append(
                f"Not searched, because they are more than {_DEEPEST} levels deep: folders in "
                f"{listed(unsearched, _MOST_FOREIGN)}. A bag there can be read by its path."
            )
        return " ".join(told)

    def find_bag(self, name: str) -> Path:
        """Return the path of a bag that may be read.

        Raises:
            NotFound: if there is no bag of that name below the folders.
            BadInput: if the name leads out of the folders.
        """
        if self.subject and name == self.subject.name:
            return self.subject
        from ros2_mcp.bags.recordings import is_recording  # imports YAML

        if "\0" in name:  # no file name contains it, and `pathlib` would fail
            raise BadInput(
                f"{name!r} is not the name of a bag: it contains a NUL character.", "ros2_bag_list shows the names."
            )
        name = BLACK_BOX if name.strip().lower() in _BLACK_BOX_WORDS else name
        paths = [path for root in self._roots if (path := (root / name).resolve()).is_relative_to(root.resolve())]
        if not paths:  # such as `../secrets`, or a link out of the folder
            raise BadInput(f"{name!r} is outside the folder of bags.", "ros2_bag_list lists what can be read.")
        for path in paths if name.strip("./") else ():
            if os.path.lexists(path) or is_recording(path):
                return path
        if name == BLACK_BOX:
            raise NotFound("This server keeps no black box.", "Start the server with --black-box to keep one.")
        raise NotFound(
            f"There is no bag {name!r} in {self.bag_dir}.",
            did_you_mean(name, list(self.bag_names()), self.which()),
        )

    def which(self) -> str:
        """Return a hint: the names of the first bags that may be read, if there are any,
        and the tool that lists them all.
        """
        first = listed(list(self.bag_names()), _MOST_TOLD)
        return f"{f'Bags: {first}. ' if first else ''}ros2_bag_list lists what can be read."

    def opened_names(self) -> list[str]:
        """Return the names of the open bags, as `reading` takes them, the last bag first."""
        with self._looking_up:
            return [opened.name for opened in self._opened.values() if opened.bag][::-1]

    @contextmanager
    def reading(self, name: str) -> Generator[Bag, None, None]:
        """Return a bag for one thread to read. It stays open for the next time, unless it changes meanwhile."""
        with self.opened(name).reading() as bag:
            yield bag

    def opened(self, name: str) -> OpenedBag:
        """Return a bag that will be opened when it is read. Raises the same errors as `find_bag`."""
        path = self.find_bag(name)
        with self._looking_up:
            opened = self._opened[path] = self._opened.pop(path, None) or OpenedBag(name, path)
            while len(self._opened) > _MOST_OPEN:
                del self._opened[next(iter(self._opened))]
            return opened

    @property
    def _roots(self) -> Sequence[Path]:
        """The folders that may be read. If both have a bag of the same name, the one recorded here is used."""
        return list(dict.fromkeys((self.record_dir, self.bag_dir)))


def _below(root: Path) -> tuple[list[Path], list[Path]]:
    """Return the folder itself and the readable folders below it, without hidden folders; and the folders whose
    subfolders are too deep to be searched.
    """
    searched: list[Path] = []
    deeper: list[Path] = []
    for parent, folders, _ in os.walk(root):
        path = Path(parent)
        searched.append(path)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        with suppress(PermissionError):  # links, which `os.walk` does not enter
            searched += [path / name for name in folders if (path / name).is_symlink()]
        if len(path.relative_to(root).parts) == _DEEPEST and folders:
            deeper.append(path)
            folders.clear()  # `os.walk` goes no deeper then
    return searched, deeper


def _schemas(bag: Bag) -> dict[str, tuple[str, str]]:
    return {topic.name: (topic.type, topic.definition) for topic in bag.topics.values()}


def _mark(path: Path) -> tuple[int, int]:
    """Return the total size and the newest modification time (ns) of the files, which differ whenever the files do."""
    from ros2_mcp.bags.recordings import files_of

    size = newest_ns = 0
    files = list(path.glob("*")) if path.is_dir() else []
    with suppress(RobotError):
        files = files or files_of(path)
    for file in files:
        with suppress(OSError):  # a ring drops its oldest file at any time; reading the bag reports missing files
            if file.is_file():
                facts = file.stat()
                size, newest_ns = size + facts.st_size, max(newest_ns, facts.st_mtime_ns)
    return size, newest_ns


def _grows_no_more() -> bool:
    return False
