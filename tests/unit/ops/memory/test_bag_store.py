"""The folders of bags: what is listed is what can be read, and a bag that opens slowly keeps nobody waiting."""

from __future__ import annotations

import os
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from ros2_mcp.bags.stored import Span, StoredTopic
from ros2_mcp.bags.writer import BagWriter
from ros2_mcp.model.errors import BadData, NotFound
from ros2_mcp.model.samples import Sample
from ros2_mcp.ops.memory import bags
from ros2_mcp.ops.memory.bag_store import BagStore

NOBODY = 65534
COUNT = StoredTopic("/count", "std_msgs/msg/Int32", None, "ros2msg", "int32 data\n")


def make_bag(folder: Path, value: int = 1) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    writer = BagWriter(folder, folder.name)
    writer.add_topic(COUNT)
    writer.write("/count", Sample(10**18, 0, 1, b"\0\1\0\0" + value.to_bytes(4, "little")))
    writer.close()


@pytest.fixture
async def remember(anyio_backend: str) -> AsyncIterator[Callable[..., BagStore]]:
    made: list[BagStore] = []

    def make(*folders: Path) -> BagStore:
        made.append(BagStore(*folders))
        return made[-1]

    yield make
    for store in made:
        await store.close()


@contextmanager
def without_privileges() -> Iterator[None]:
    privileged = os.geteuid() == 0
    if privileged:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if privileged:
            os.seteuid(0)


@pytest.mark.promise("ros2_bag_list", "List the bags (recordings) that can be read")
@pytest.mark.promise("README", "--bag-dir DIR opens the bags that are there")
async def test_loose_files_and_links_are_listed_as_far_as_they_can_be_read(
    tmp_path: Path, remember: Callable[..., BagStore]
) -> None:
    root, elsewhere = tmp_path / "bags", tmp_path / "elsewhere"
    make_bag(root / "deep" / "run")
    make_bag(elsewhere / "run")
    make_bag(root)  # a loose file, and metadata.yaml
    (root / "latest").symlink_to(root / "deep" / "run")
    (root / "out").symlink_to(elsewhere / "run")
    (root / "out.mcap").symlink_to(elsewhere / "run" / "run_0.mcap")
    (root / "gone.mcap").symlink_to(root / "nowhere.mcap")
    store = remember(root, root)
    listed = await bags.list_bags(store)
    assert sorted(entry.bag for entry in listed.bags) == ["bags_0.mcap", "deep/run", "latest"]
    for entry in listed.bags:
        with store.reading(entry.bag) as bag:
            assert [topic for topic, _ in bag.messages()] == ["/count"]
    assert len(store.opened_names()) == 2  # the link and what it leads to are one bag


def test_a_bag_goes_by_its_whole_path_too(tmp_path: Path, remember: Callable[..., BagStore]) -> None:
    make_bag(tmp_path / "bags" / "run")
    store = remember(tmp_path / "recordings", tmp_path / "bags")
    with store.reading(str(tmp_path / "bags" / "run")) as bag:
        assert set(bag.topics) == {"/count"}


def test_what_was_recorded_here_comes_before_a_bag_of_the_same_name(
    tmp_path: Path, remember: Callable[..., BagStore]
) -> None:
    make_bag(tmp_path / "bags" / "black-box", 1)
    make_bag(tmp_path / "recordings" / "black-box", 2)
    store = remember(tmp_path / "recordings", tmp_path / "bags")
    assert store.bag_names()["black-box"] == tmp_path / "recordings" / "black-box"
    with store.reading("black box") as bag:
        assert [sample.data[4] for _, sample in bag.messages()] == [2]


async def test_a_folder_that_cannot_be_looked_into_is_skipped(remember: Callable[..., BagStore]) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        root = Path(name)
        make_bag(root / "run")
        store = remember(root)
        await bags.list_bags(store)
        for closed, mode in (("lost+found", 0), ("names-only", 0o444)):
            make_bag(root / closed / "inside")
            make_bag(root / closed)
            (root / closed).chmod(mode)
        root.chmod(0o755)
        with without_privileges():
            assert [entry.bag for entry in (await bags.list_bags(store)).bags] == ["run"]
            with pytest.raises(NotFound, match="no bag 'rum'"):
                store.find_bag("rum")
            with pytest.raises(NotFound, match="no bag"):
                store.find_bag("lost+found/inside")
            with pytest.raises(BadData, match="cannot be read"), store.reading("lost+found"):
                pass
            assert store.opened_names() == []


def test_a_bag_that_opens_slowly_keeps_nobody_else_waiting(tmp_path: Path, remember: Callable[..., BagStore]) -> None:
    for name in ("run", "slow"):
        make_bag(tmp_path / name)
    (tmp_path / "slow" / "metadata.yaml").unlink()
    os.mkfifo(tmp_path / "slow" / "metadata.yaml")  # whoever reads it waits for a writer
    store = remember(tmp_path)

    def topics_of(name: str) -> set[str]:
        with store.reading(name) as bag:
            return set(bag.topics)

    with ThreadPoolExecutor(4) as threads:
        slow = [threads.submit(topics_of, "slow") for _ in range(2)]
        writer = os.open(tmp_path / "slow" / "metadata.yaml", os.O_WRONLY)  # returns as soon as it is being read
        try:
            assert threads.submit(topics_of, "run").result(5) == {"/count"}
            assert threads.submit(store.opened_names).result(5) == ["run"]
            assert not any(each.done() for each in slow)
        finally:
            os.close(writer)
        assert [each.result(5) for each in slow] == [{"/count"}] * 2


async def test_a_bag_that_a_thread_reads_is_not_closed_under_it(
    remember: Callable[..., BagStore], tmp_path: Path
) -> None:
    """The call may be over, cancelled, and the server at its end: its thread reads on."""
    make_bag(tmp_path / "read")
    make_bag(tmp_path / "idle")
    store = remember(tmp_path)
    with store.reading("idle") as idle:
        pass
    with store.reading("read") as bag:
        await store.close()
        assert [int.from_bytes(sample.data[-4:], "little") for _, sample in bag.messages(Span())] == [1]
    with pytest.raises(ValueError, match="closed file"):
        next(iter(idle.messages(Span())))
