"""What one server remembers with: its folders, and the recordings and playbacks under way."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ros2_mcp.model.errors import BadInput, NotFound
from ros2_mcp.model.names import did_you_mean

if TYPE_CHECKING:
    from ros2_mcp.bags.bag import Bag

RECORDINGS = Path("~/ros2-mcp/recordings")
_MOST_OPEN = 4
BLACK_BOX = "black-box"
"""The name of the server's own black box among the bags."""
_BLACK_BOX_WORDS = ("black box", "black_box", "blackbox")


class Ending(Protocol):
    """Something that runs until it is ended."""

    async def end(self) -> None:
        """Ends it in good order; safe to call twice."""
        ...


@dataclass(slots=True)
class OpenedBag:
    """A bag that stays open; only one thread at a time may read it."""

    bag: Bag
    mark: tuple[int, int]
    lock: threading.Lock = field(default_factory=threading.Lock)


class Memory:
    """The folders that may be written (`record_dir`) and read (`bag_dir`, and what was recorded).

    `subject` is the recording that stands for the robot, if one does; it may be read wherever it is.
    `running` has the recordings and playbacks of this server by their ids, those that have ended too.
    """

    def __init__(self, record_dir: Path = RECORDINGS, bag_dir: Path | None = None, subject: Path | None = None) -> None:
        self.subject = subject.expanduser().resolve() if subject else None
        self.record_dir = record_dir.expanduser()
        self.bag_dir = bag_dir.expanduser() if bag_dir else self.record_dir
        self.running: dict[str, Ending] = {}
        self._opened: dict[Path, OpenedBag] = {}
        self._opening = threading.Lock()

    @property
    def subject_name(self) -> str:
        """The name of the recording that stands for the robot; empty where there is none."""
        return self.subject.name if self.subject else ""

    async def close(self) -> None:
        """Ends everything that runs: recordings get their index and their `metadata.yaml`."""
        for each in list(self.running.values()):
            await each.end()
        for opened in self._opened.values():
            opened.bag.close()
        self._opened.clear()

    # ── bags ───────────────────────────────────────────────────────────────────────────────────────────────────

    def bag_names(self) -> dict[str, Path]:
        """Every bag that may be read, by its name: its path below the folder."""
        from ros2_mcp.bags.bag import is_bag

        found: dict[str, Path] = {self.subject.name: self.subject} if self.subject else {}
        for root in dict.fromkeys((self.bag_dir, self.record_dir)):
            for path in sorted(_below(root, 4)):
                if is_bag(path) and (path.is_dir() or not is_bag(path.parent)):
                    found.setdefault(str(path.relative_to(root)), path)
        return found

    def find_bag(self, name: str) -> Path:
        """The path of a bag that may be read.

        Raises:
            NotFound: if there is none of that name below the folders.
            BadInput: if the name leads elsewhere.
        """
        if self.subject and name == self.subject.name:
            return self.subject
        name = BLACK_BOX if name.strip().lower() in _BLACK_BOX_WORDS else name
        for root in dict.fromkeys((self.bag_dir, self.record_dir)):
            path = (root / name).resolve()
            if not path.is_relative_to(root.resolve()):
                raise BadInput(f"{name!r} is not below the folder of bags.", "ros2_bag_list shows what can be read.")
            if name.strip("./") and path.exists():
                return path
        raise NotFound(
            f"There is no bag {name!r} in {self.bag_dir}.",
            did_you_mean(name, list(self.bag_names()), "ros2_bag_list shows what can be read."),
        )

    def opened_names(self) -> list[str]:
        """The bags that are open, by the names that `reading` takes, the last one first."""
        with self._opening:
            opened = list(self._opened)[::-1]
        names = {path.resolve(): name for name, path in self.bag_names().items()}
        return [names[path] for path in opened if path in names]

    @contextmanager
    def reading(self, name: str) -> Generator[Bag, None, None]:
        """A bag for one thread to read; it stays open for the next time, unless it changes meanwhile."""
        opened = self._open(self.find_bag(name))
        with opened.lock:
            yield opened.bag

    def _open(self, path: Path) -> OpenedBag:
        from ros2_mcp.bags.bag import Bag

        with self._opening:
            mark = _mark(path)
            opened = self._opened.pop(path, None)
            if opened is None or opened.mark != mark:
                opened = OpenedBag(Bag(path), mark)
            self._opened[path] = opened
            while len(self._opened) > _MOST_OPEN:
                del self._opened[next(iter(self._opened))]
            return opened


def _below(root: Path, depth: int) -> Iterator[Path]:
    if depth == 0 or not root.is_dir():
        return
    for path in root.iterdir():
        if not path.name.startswith("."):
            yield path
            if path.is_dir() and not path.is_symlink():
                yield from _below(path, depth - 1)


def _mark(path: Path) -> tuple[int, int]:
    """Changes whenever the files do."""
    files = [path] if path.is_file() else [each for each in path.iterdir() if each.is_file()]
    facts = [each.stat() for each in files]
    return sum(each.st_size for each in facts), max((each.st_mtime_ns for each in facts), default=0)
