"""The link against the real bridge in a process of its own."""

import asyncio
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import venv
from collections.abc import AsyncIterator, Awaitable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from ros2_mcp.link.carrier import Carrier
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge, Reply
from ros2_mcp.link.installation import WHEEL_GUARD
from ros2_mcp.link.local import LocalBridge, start_local
from ros2_mcp.model.errors import BridgeLost, BridgeRefused, LinkError, RosNotFound
from ros2_mcp.settings import Settings
from ros2_mcp_common.start.finding import rclpy_below
from support.standstill import undisturbed_async
from support.tasks import running_tasks

ENV = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
QOS = {"reliability": "reliable", "durability": "volatile", "history": "keep_last", "depth": 100}
PATIENCE_S = 30.0
STRING = b"\x00\x01\x00\x00\x06\x00\x00\x00hello\x00"


@asynccontextmanager
async def launched(settings: Settings) -> AsyncIterator[Bridge]:
    """A bridge for a block, whose process has gone and which has no task left after it."""
    before = running_tasks()
    carriers: list[LocalBridge] = []

    def start() -> LocalBridge:
        carriers.append(start_local(settings, ENV))
        return carriers[-1]

    bridge = Bridge(start)
    bridge.launch()
    try:
        yield bridge
    finally:
        await bridge.close()
    assert running_tasks() == before
    assert not any(_lives(carrier.pid) for carrier in carriers)


@pytest.fixture(scope="module")
def settings(domain_id: int) -> Settings:
    return Settings(domain_id=domain_id)


@pytest.fixture(scope="module")
async def bridge(settings: Settings) -> AsyncIterator[Bridge]:
    """The bridge of the tests that do not lose theirs."""
    async with launched(settings) as bridge:
        await bridge.ready()
        yield bridge


@pytest.fixture
async def own_bridge(settings: Settings) -> AsyncIterator[Bridge]:
    async with launched(settings) as bridge:
        yield bridge


def _lives(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


async def test_a_launched_bridge_answers_and_leaves_when_closed(bridge: Bridge, domain_id: int) -> None:
    reply = await bridge.request("topics", settle_s=2.0, timeout_s=PATIENCE_S)
    assert isinstance(reply.ok["topics"], list)
    assert bridge.hello
    assert bridge.hello.domain_id == domain_id


async def test_what_is_published_arrives_at_a_subscription_byte_for_byte(bridge: Bridge) -> None:
    topic, kind = "/link_test", "std_msgs/msg/String"
    async with await bridge.subscribe(
        topic, kind, QOS, keep="all", max_samples=100, max_bytes=10_000_000
    ) as subscription:
        sent = await bridge.request(
            "publish",
            STRING,
            timeout_s=PATIENCE_S,
            topic=topic,
            type=kind,
            qos=QOS,
            epoch=0,
            wait_match_s=10,
            wait_ack_s=10,
        )
        assert sent.ok["matched"] >= 1
        taken = await subscription.take(PATIENCE_S)
        assert [sample.data[: len(STRING)] for sample in taken] == [STRING]
    assert subscription.counts.received == 1


async def test_a_large_body_goes_both_ways_without_holding_up_other_requests(bridge: Bridge) -> None:
    topic, kind, size = "/link_large", "std_msgs/msg/UInt8MultiArray", 10_000_000
    body = b"\x00\x01\x00\x00" + bytes(4) + bytes(4) + size.to_bytes(4, "little") + os.urandom(size)
    async with await bridge.subscribe(
        topic, kind, QOS, keep="all", max_samples=10, max_bytes=50_000_000
    ) as subscription:
        publish = asyncio.ensure_future(
            bridge.request(
                "publish", body, timeout_s=40, topic=topic, type=kind, qos=QOS, epoch=0, wait_match_s=10, wait_ack_s=10
            )
        )
        await bridge.request("ping", timeout_s=PATIENCE_S)
        await publish
        taken = await subscription.take(PATIENCE_S)
        assert [sample.data[: len(body)] for sample in taken] == [body]
    assert bridge.restarts == []


LOSSES = [(signal.SIGKILL, "died with signal SIGKILL"), (signal.SIGSTOP, "was stopped")]


@pytest.mark.parametrize(("number", "words"), LOSSES)
async def test_a_lost_bridge_fails_the_call_long_before_its_time_is_over_and_the_next_call_works(
    own_bridge: Bridge, number: signal.Signals, words: str
) -> None:
    await lost_after_s(own_bridge, number, words)
    assert words in own_bridge.restarts[0]


@pytest.mark.full
@pytest.mark.parametrize(("number", "words"), LOSSES)
async def test_a_lost_bridge_fails_the_call_within_a_second(
    own_bridge: Bridge, number: signal.Signals, words: str
) -> None:
    assert await undisturbed_async(lambda: lost_after_s(own_bridge, number, words)) < 1.0


async def lost_after_s(bridge: Bridge, number: signal.Signals, words: str) -> float:
    """How long after its bridge got a signal what waits for 90 s was ended, and not by that time."""
    first, generation = (await bridge.ready()).pid, bridge.generation
    waiting = asyncio.ensure_future(
        bridge.request("wait_endpoints", topic="/nobody", publishers=1, subscribers=0, timeout_s=90)
    )
    subscription = await bridge.subscribe(
        "/nobody", "std_msgs/msg/String", QOS, keep="all", max_samples=10, max_bytes=1000
    )
    take = asyncio.ensure_future(subscription.take(90))
    await bridge.request("ping", timeout_s=PATIENCE_S)
    os.kill(first, number)
    begun = time.monotonic()
    for lost in (waiting, take):
        with pytest.raises(BridgeLost, match=words):
            await lost
    took = time.monotonic() - begun
    await bridge.request("ping", timeout_s=PATIENCE_S)
    assert bridge.generation == generation + 1
    assert (await bridge.ready()).pid != first
    assert not _lives(first)
    return took


async def test_a_cancelled_call_and_a_cancelled_subscribe_leave_nothing_in_the_bridge(bridge: Bridge) -> None:
    await bridge.ready()
    for delay_s in (0.0, 0.0005, 0.002, 0.01):
        ask = asyncio.ensure_future(
            bridge.subscribe("/brief", "std_msgs/msg/String", QOS, keep="all", max_samples=10, max_bytes=1000)
        )
        await asyncio.sleep(delay_s)
        if not ask.cancel():
            await ask.result().close()
        await asyncio.wait({ask})
    deadline = time.monotonic() + PATIENCE_S
    while (await bridge.request("stats", timeout_s=PATIENCE_S)).ok["subscriptions"]:
        assert time.monotonic() < deadline
        await asyncio.sleep(0.02)


async def test_who_comes_and_goes_at_a_topic_shares_one_subscription_and_misses_nothing_while_there(
    bridge: Bridge,
) -> None:
    topic, kind = "/shared", "std_msgs/msg/String"
    published = {"topic": topic, "type": kind, "qos": QOS, "epoch": 0, "wait_match_s": 10, "wait_ack_s": 0}
    repeat = {**published, "rate_hz": 500, "duration_s": 60, "name": "steady"}
    repeating = asyncio.ensure_future(bridge.request("repeat", STRING, timeout_s=PATIENCE_S, **repeat))

    async def listens(number: int) -> None:
        async with await bridge.subscribe(topic, kind, QOS, keep="all", max_samples=1000, max_bytes=10**6) as listening:
            taken = await listening.take(PATIENCE_S)
            while len(taken) < 50 + 10 * (number % 3):
                taken += await listening.take(PATIENCE_S)
        taken += await listening.take(0.0)
        numbers = [sample.sequence for sample in taken]
        assert numbers == list(range(numbers[0] or 0, (numbers[0] or 0) + len(numbers)))
        assert (listening.counts.received, listening.counts.dropped, listening.counts.lost) == (len(numbers), 0, 0)

    def subscriptions() -> Awaitable[Reply]:
        return bridge.request("stats", timeout_s=PATIENCE_S)

    listeners: list[asyncio.Future[None]] = []
    while len(listeners) < 20 or not all(listener.done() for listener in listeners):
        if len(listeners) < 20:  # one after the other, while those before are there
            listeners.append(asyncio.ensure_future(listens(len(listeners))))
        assert (await subscriptions()).ok["subscriptions"] <= 2  # one that ends, and one that begins
        await asyncio.sleep(0.01)
    await asyncio.gather(*listeners)
    assert (await subscriptions()).ok["subscriptions"] == 0
    await bridge.request("repeat_stop", name="steady", timeout_s=PATIENCE_S)
    assert (await repeating).ok["sent"]


async def test_a_refusal_of_the_bridge_arrives_with_its_kind(bridge: Bridge) -> None:
    with pytest.raises(BridgeRefused) as refused:
        await bridge.request("node", name="nobody", namespace="/", settle_s=0.0, timeout_s=PATIENCE_S)
    assert refused.value.kind == "not_found"


@pytest.mark.promise("README", "every answer says what is missing and how to get it")
async def test_without_ros_every_request_says_what_is_missing_and_it_is_looked_for_again(settings: Settings) -> None:
    there = False

    def start() -> Carrier:
        if not there:
            raise RosNotFound("No ROS 2 found.", "Run: this")
        return start_carrier(settings, ENV)

    async with Bridge(start) as bridge:
        for _ in range(2):
            with pytest.raises(RosNotFound, match="Run: this"):
                await bridge.request("ping", timeout_s=PATIENCE_S)
        there = True
        deadline = time.monotonic() + PATIENCE_S
        while bridge.hello is None and time.monotonic() < deadline:
            try:
                await bridge.request("ping", timeout_s=PATIENCE_S)
            except RosNotFound:
                await asyncio.sleep(0.1)
        assert bridge.hello


async def test_a_python_without_rclpy_is_reported_with_what_it_said(tmp_path: Path, domain_id: int) -> None:
    venv.create(tmp_path / "empty", with_pip=False)
    settings = Settings(bridge_python=tmp_path / "empty" / "bin" / "python", domain_id=domain_id)

    async with launched(settings) as bridge:
        with pytest.raises(LinkError, match="rclpy"):
            await bridge.request("ping", timeout_s=PATIENCE_S)


# ── the server under one Python, ROS under another ─────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def other_ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A ROS root whose `jazzy` runs under another Python than ours, if this machine has uv and one; its version."""
    python = _another_python()
    uv = shutil.which("uv")
    if not python or not uv:
        pytest.skip("there is no uv, or no second Python (3.10 to 3.14) on PATH to install ROS 2 wheels for")
    root = tmp_path_factory.mktemp("other ros's root")
    prefix = root / "venv"
    packages = ["ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-common-interfaces", "numpy"]
    subprocess.run([uv, "venv", "-q", "-p", python, str(prefix)], check=True, timeout=60)
    install = [uv, "pip", "install", "-q", "-p", str(prefix / "bin" / "python"), *packages]
    subprocess.run(install, check=True, timeout=240, env={**os.environ, WHEEL_GUARD: "1"})
    _write_setup(root / "jazzy", prefix)
    yield root, python.rpartition("python")[2]
    shutil.rmtree(root)


def _another_python() -> str | None:
    others = (f"python3.{minor}" for minor in (12, 13, 10, 14) if minor != sys.version_info.minor)
    return next(filter(None, map(_real_python, others)), None)


def _real_python(name: str) -> str | None:
    """The interpreter of that name that runs, seen through the shims of pyenv, which are there for all versions."""
    if not shutil.which(name):
        return None
    asked = [name, "-c", "import sys; print(sys.base_prefix)"]
    env = {**os.environ, "PYENV_VERSION": name.removeprefix("python"), WHEEL_GUARD: "1"}
    done = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=20, env=env)
    return str(Path(done.stdout.strip()) / "bin" / name) if done.returncode == 0 else None


def _write_setup(distro: Path, prefix: Path) -> None:
    """What /opt/ros/<distro>/setup.bash does, for an environment of wheels."""
    site_packages = next(rclpy_below(prefix)).parent
    libraries = os.pathsep.join(str(folder) for folder in (prefix / "lib", *site_packages.glob("ros_*.libs")))
    distro.mkdir()
    values = {
        "PATH": f"{prefix / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(site_packages),
        "LD_LIBRARY_PATH": libraries,
        "AMENT_PREFIX_PATH": str(prefix),
        "ROS_DISTRO": "jazzy",
    }
    lines = [f"export {name}={shlex.quote(value)}" for name, value in values.items()]
    (distro / "setup.bash").write_text("\n".join([*lines, "echo this must not reach the stream"]) + "\n")


@pytest.mark.promise("README", "The server runs under any Python")
@pytest.mark.promise("README", "only its bridge, a small process beside it, runs under the Python of ROS 2")
@pytest.mark.timeout(360)
async def test_the_bridge_runs_under_the_python_of_an_unsourced_ros_whatever_ours_is(
    other_ros: tuple[Path, str], domain_id: int
) -> None:
    root, version = other_ros

    async with launched(Settings(ros_root=root, distro="jazzy", domain_id=domain_id + 1)) as bridge:
        hello = await bridge.ready()
        assert bridge.origin == f"{root / 'jazzy'}/setup.bash is sourced for the bridge (asked for)."
        assert hello.python.startswith(version + ".")
        assert not hello.python.startswith(f"3.{sys.version_info.minor}.")
        assert (await bridge.request("interfaces", timeout_s=PATIENCE_S)).ok["interfaces"]


# ── the end of the server ──────────────────────────────────────────────────────────────────────────────────────

_SERVER = """
import asyncio
import signal
import sys
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge, Reply
from ros2_mcp.settings import Settings

async def main():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # even where the tests run in the background
    bridge = Bridge(lambda: start_carrier(Settings(domain_id=int(sys.argv[1]))))
    print((await bridge.ready()).pid, flush=True)
    await asyncio.sleep(60)

asyncio.run(main())
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_the_bridge_leaves_when_its_server_dies(number: signal.Signals, domain_id: int) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _SERVER, str(domain_id + 2)],
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as server:
        assert server.stdout
        pid = int(server.stdout.readline())
        server.send_signal(number)
        try:
            server.wait(PATIENCE_S)
        finally:
            server.kill()
    deadline = time.monotonic() + PATIENCE_S
    while _lives(pid):
        assert time.monotonic() < deadline, "the bridge outlived its server"
        time.sleep(0.02)


@pytest.mark.full
async def test_twenty_lost_bridges_leave_no_open_files_behind(own_bridge: Bridge) -> None:
    bridge = own_bridge
    await bridge.ready()
    before = _open_files()
    for _ in range(20):
        os.kill((await bridge.ready()).pid, signal.SIGKILL)
        with pytest.raises(BridgeLost):
            await bridge.request("topics", settle_s=0.0, timeout_s=PATIENCE_S)
        await bridge.request("ping", timeout_s=PATIENCE_S)
    assert _open_files() == before
    assert (bridge.generation, len(bridge.restarts)) == (21, 20)


def _open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))
