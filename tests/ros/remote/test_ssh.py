"""A robot behind a real sshd: reached with nothing installed there, and nothing left there."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from inspect import signature
from pathlib import Path

import pytest

from ros2_mcp.link import remote
from ros2_mcp.link.carriers import start_carrier
from ros2_mcp.link.client import Bridge
from ros2_mcp.model.address import parse_address
from ros2_mcp.model.errors import Unreachable
from ros2_mcp.settings import Settings
from support.agent import FULL, until
from support.bridge_client import RELIABLE, STRING, cdr_string
from support.ports import free_port
from support.sshd import Sshd

PATIENCE_S = 60.0
# Of the issue: whatever is wrong is told within this time.
TOLD_S = 12.0
OLD_HELLO_S = 8.0
"""After it a command is late that only the hello makes fresh, by 3.5 s (LATE_S of the bridge)."""


@pytest.fixture
async def reach(far: Sshd, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Callable[..., Bridge]]:
    bridges: list[Bridge] = []
    if not FULL:
        monkeypatch.setattr(remote, "REACH_S", PATIENCE_S)  # a login of a busy machine may take longer than 12 s

    def begin(address: str = "", options: tuple[str, ...] = (), **more: object) -> Bridge:
        robot = parse_address(address or far.address())
        settings = Settings(robots=(robot,), ssh_options=options or far.options(), **more)  # type: ignore[arg-type]
        bridges.append(Bridge(lambda: start_carrier(settings)))
        return bridges[-1]

    yield begin
    for bridge in bridges:
        await bridge.close()


@pytest.fixture
def login(far: Sshd) -> Iterator[Callable[[str], object]]:
    """Gives the logins a start-up file of bash."""
    file = far.home / ".bashrc"
    yield file.write_text
    file.unlink(missing_ok=True)


async def test_it_is_reached_and_answers(reach: Callable[..., Bridge], far: Sshd, domain_id: int) -> None:
    bridge = reach()
    hello = await bridge.ready()
    assert hello.domain_id == domain_id
    assert far.address() in bridge.origin
    reply = await bridge.request("stats", timeout_s=PATIENCE_S)
    assert reply.ok["publishers"] == 0


async def test_it_comes_up_while_the_server_is_still_being_imported(reach: Callable[..., Bridge], far: Sshd) -> None:
    bridge = reach()
    bridge.launch()
    until(lambda: any(b"ros2_mcp_bridge" in line for line in far.command_lines()), 60.0)  # nobody runs an event loop
    if FULL:
        await asyncio.sleep(OLD_HELLO_S)
    first = {"topic": "/first", "type": STRING, "qos": RELIABLE, "epoch": 0}
    await bridge.request("publish", cdr_string("It is not late."), timeout_s=PATIENCE_S, **first)


@pytest.mark.promise("README", "with nothing installed and nothing written there")
async def test_nothing_is_written_in_the_home_of_who_logs_in(reach: Callable[..., Bridge], far: Sshd) -> None:
    bridge = reach()
    await bridge.ready()
    await bridge.close()
    assert list(far.home.iterdir()) == []


async def test_a_login_that_prints_is_no_hindrance(
    reach: Callable[..., Bridge], login: Callable[[str], object], domain_id: int
) -> None:
    login("echo Welcome to the robot; printf '\\0\\377\\n'; echo and to its stderr >&2\n")
    assert (await reach().ready()).domain_id == domain_id


async def test_domain_and_user_options_reach_the_far_side(reach: Callable[..., Bridge], domain_id: int) -> None:
    assert (await reach(domain_id=domain_id + 1).ready()).domain_id == domain_id + 1


# ── ways to fail: each is one sentence with the way out ────────────────────────────────────────────────────────


async def refusal(bridge: Bridge) -> Unreachable:
    """Why it is not reached."""
    with pytest.raises(Unreachable) as refused:
        await bridge.ready()
    return refused.value


async def test_a_name_that_nobody_knows(reach: Callable[..., Bridge]) -> None:
    told = await refusal(reach("ssh://nobody.invalid"))
    assert told.message == "There is no machine called nobody.invalid: its name is not known here."
    assert "~/.ssh/config" in told.hint


async def test_a_port_at_which_nobody_listens(reach: Callable[..., Bridge], far: Sshd) -> None:
    port = free_port()
    told = await refusal(reach(far.address(port)))
    assert told.message == f"127.0.0.1 is there, but nothing answers at its port {port}."
    assert "openssh-server" in told.hint


async def test_a_machine_that_does_not_answer(reach: Callable[..., Bridge], far: Sshd) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        told = await refusal(reach(far.address(port), ("-oConnectTimeout=1", *far.options())))
    assert told.message == "127.0.0.1 does not answer."
    assert "switched on" in told.hint


async def test_a_machine_that_hangs_up(reach: Callable[..., Bridge], far: Sshd) -> None:
    with socket.create_server(("127.0.0.1", 0)) as rude:
        bridge = reach(far.address(rude.getsockname()[1]))
        bridge.launch()
        rude.settimeout(PATIENCE_S)
        (await asyncio.to_thread(rude.accept))[0].close()
        told = await refusal(bridge)
    assert told.message.startswith("127.0.0.1 ended the connection: ")
    assert "log" in told.hint


async def test_a_host_key_that_is_not_known(reach: Callable[..., Bridge], far: Sshd, tmp_path: Path) -> None:
    options = far.options(known_hosts=tmp_path / "none")
    told = await refusal(reach(options=options))
    assert (
        told.message
        == "The host key of 127.0.0.1 is not known here, and this server never accepts a new one by itself."
    )
    settings = " ".join(
        f"--ssh-option={option}" for option in options
    )  # with which it is reached, by the doctor as well
    assert f"ros2-mcp doctor --robot {far.address()} {settings}" in told.hint


async def test_a_host_key_that_has_changed(reach: Callable[..., Bridge], far: Sshd, tmp_path: Path) -> None:
    other = (far.folder / "key.pub").read_text().split()[1]
    known = tmp_path / "known"
    known.write_text(f"[127.0.0.1]:{far.port} ssh-ed25519 {other}\n")
    told = await refusal(reach(options=far.options(known_hosts=known)))
    assert "another host key" in told.message
    assert f"ssh-keygen -R '[127.0.0.1]:{far.port}'" in told.hint


async def test_a_key_that_is_not_let_in(reach: Callable[..., Bridge], far: Sshd) -> None:
    options = far.options(key=far.folder / "host_key")
    told = await refusal(reach(options=options))
    assert told.message.startswith(f"127.0.0.1 does not let {far.user} in: ")
    settings = " ".join(option for option in options if option.startswith(("-o", "-F")))
    assert f"ssh-copy-id {settings} -p {far.port} {far.user}@127.0.0.1" in told.hint


async def test_an_option_that_ssh_does_not_know(reach: Callable[..., Bridge], far: Sshd) -> None:
    told = await refusal(reach(options=(*far.options(), "-oNoSuchThing=1")))
    assert told.message.startswith("ssh does not understand what it was given: ")
    assert "--ssh-option" in told.hint


async def test_a_machine_without_ros(reach: Callable[..., Bridge], login: Callable[[str], object]) -> None:
    login("PATH=/usr/bin:/bin\n")
    told = await refusal(reach(ros_root=Path("/nowhere"), distro="none"))
    assert "No ROS 2 found there" in told.message
    assert told.hint


async def test_a_login_that_ends_by_itself(reach: Callable[..., Bridge], login: Callable[[str], object]) -> None:
    login("exit 0\n")
    told = await refusal(reach())
    assert "ended before the bridge started" in told.message
    assert ".bashrc" in told.hint


async def test_a_login_that_is_not_available(reach: Callable[..., Bridge], login: Callable[[str], object]) -> None:
    login("echo This account is currently not available.; exit 1\n")
    told = await refusal(reach())
    assert "This account is currently not available." in told.message
    assert told.hint


async def test_a_login_that_prints_for_ever(reach: Callable[..., Bridge], login: Callable[[str], object]) -> None:
    login("yes\n")
    told = await refusal(reach())
    assert "did not start" in told.message
    assert ".bashrc" in told.hint


async def test_a_login_that_waits_for_ever(
    reach: Callable[..., Bridge], login: Callable[[str], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    login("echo Choose a robot:; cat >/dev/null\n")
    patience_s = 2.0  # nobody waits for longer here, unless the login of a busy machine has said nothing until then
    while True:
        monkeypatch.setattr(remote, "REACH_S", patience_s)
        told = await refusal(reach())
        if "Choose a robot:" in told.message or patience_s > 20.0:
            break
        patience_s *= 4
    assert "Choose a robot:" in told.message
    assert ".bashrc" in told.hint


async def test_a_machine_on_which_there_is_no_ssh(
    reach: Callable[..., Bridge], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    told = await refusal(reach())
    assert told.message == "ssh cannot be started: No such file or directory."
    assert told.hint.startswith("Install it")


WAYS_TO_FAIL = [
    test_a_name_that_nobody_knows,
    test_a_port_at_which_nobody_listens,
    test_a_machine_that_does_not_answer,
    test_a_machine_that_hangs_up,
    test_a_host_key_that_is_not_known,
    test_a_host_key_that_has_changed,
    test_a_key_that_is_not_let_in,
    test_an_option_that_ssh_does_not_know,
    test_a_machine_without_ros,
    test_a_login_that_ends_by_itself,
    test_a_login_that_is_not_available,
    test_a_login_that_prints_for_ever,
    test_a_login_that_waits_for_ever,
    test_a_machine_on_which_there_is_no_ssh,
]


@pytest.mark.full
@pytest.mark.parametrize("fails", WAYS_TO_FAIL)
async def test_whatever_is_wrong_is_told_in_time(
    fails: Callable[..., Awaitable[None]],
    reach: Callable[..., Bridge],
    far: Sshd,
    login: Callable[[str], object],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    given = {"reach": reach, "far": far, "login": login, "monkeypatch": monkeypatch, "tmp_path": tmp_path}
    begun = time.monotonic()
    await fails(**{name: given[name] for name in signature(fails).parameters})
    assert time.monotonic() - begun < TOLD_S
