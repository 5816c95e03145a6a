"""A real sshd of a test's own: on loopback, with keys made for it, for the user who runs the test."""

from __future__ import annotations

import contextlib
import getpass
import os
import shutil
import subprocess
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.own_processes import marks
from support.ports import free_port
from support.rounds import QUICK

_SSHD = shutil.which("sshd", path=os.pathsep.join(["/usr/sbin", "/usr/local/sbin", os.environ.get("PATH", "")]))
# It listens within a tenth of a second; the machine may be busy.
_LISTENS_S = 60.0


@dataclass(frozen=True, kw_only=True)
class Sshd:
    """A running sshd. `known_hosts` has its key, `key` lets the user in, `process` is the one that listens.

    `home` is the home of those who log in: empty, so that nobody's start-up files matter.
    """

    host: str
    port: int
    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def user(self) -> str:
        return getpass.getuser()

    @property
    def home(self) -> Path:
        return self.folder / "home"

    @property
    def key(self) -> Path:
        return self.folder / "key"

    @property
    def known_hosts(self) -> Path:
        return self.folder / "known_hosts"

    def options(self, known_hosts: Path | None = None, key: Path | None = None) -> tuple[str, ...]:
        """What `--ssh-option` is given so that the configuration of whoever runs the test does not matter."""
        return (
            "-F/dev/null",
            f"-oUserKnownHostsFile={known_hosts or self.known_hosts}",
            "-oGlobalKnownHostsFile=/dev/null",
            f"-oIdentityFile={key or self.key}",
            "-oIdentitiesOnly=yes",
            "-oIdentityAgent=none",
        )

    def address(self, port: int | None = None, query: str = "") -> str:
        """Of `--robot`; another port where something stands between."""
        return f"ssh://{self.user}@{self.host}:{port or self.port}{query}"

    def command_lines(self) -> list[bytes]:
        """Of all that runs there of those who logged in."""
        found: list[bytes] = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # it has ended
                if f"HOME={self.home}\0".encode() in (process / "environ").read_bytes():
                    found.append((process / "cmdline").read_bytes())
        return found

    def knows(self, port: int) -> None:
        """The key is known under this port, too."""
        public = (self.folder / "host_key.pub").read_text().split()[:2]
        with self.known_hosts.open("a") as known:
            known.write(f"[{self.host}]:{port} {' '.join(public)}\n")


@contextmanager
def sshd(
    folder: Path,
    env: Mapping[str, str],
    lines: Sequence[str] = (),
    *,
    host: str = "127.0.0.1",
    before: Sequence[str] = (),
) -> Generator[Sshd, None, None]:
    """An sshd for the time of a block, whose logins have these variables; `lines` are added to its configuration.

    It listens at `host`; `before` is what its command begins with, such as the way into another network.

    Skips the test where there is none.
    """
    if QUICK or not _SSHD:
        pytest.skip("needs sshd (apt-get install openssh-server)")
    (folder / "home").mkdir(parents=True, exist_ok=True)
    for name in ("host_key", "key"):
        _make_key(folder / name)
    shutil.copy(folder / "key.pub", folder / "authorized_keys")
    port = free_port()
    variables = " ".join(f'"{name}={value}"' for name, value in {"HOME": folder / "home", **marks(), **env}.items())
    (folder / "config").write_text(
        "\n".join(
            [
                *lines,
                f"Port {port}",
                f"ListenAddress {host}",
                f"HostKey {folder / 'host_key'}",
                f"AuthorizedKeysFile {folder / 'authorized_keys'}",
                f"PidFile {folder / 'pid'}",
                "PasswordAuthentication no",
                "KbdInteractiveAuthentication no",
                "PermitRootLogin yes",
                "StrictModes no",
                "UsePAM no",
                "PrintMotd no",
                "MaxStartups 100",
                f"SetEnv {variables}",
                "",
            ]
        )
    )
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)  # it separates privileges there
    log = (folder / "log").open("wb")
    process = subprocess.Popen(
        [*before, _SSHD, "-D", "-e", "-f", str(folder / "config")], stdin=subprocess.DEVNULL, stdout=log, stderr=log
    )
    log.close()
    running = Sshd(host=host, port=port, folder=folder, process=process)
    running.knows(port)
    try:
        _await_listening(process, folder / "log")
        yield running
    finally:
        process.kill()
        process.wait()


def _make_key(path: Path) -> None:
    if not path.exists():
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)], check=True, timeout=30)


def _await_listening(process: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + _LISTENS_S
    while time.monotonic() < deadline and process.poll() is None:
        if "Server listening on" in log.read_text(errors="replace"):
            return
        time.sleep(0.01)
    raise AssertionError(f"sshd does not listen: {log.read_text(errors='replace')}")


def ssh_of(server_pid: int) -> int:
    """The process id of the ssh that a server has started."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = stat.read_text().partition("(")[2].rpartition(")")
        except OSError:
            continue
        if name == "ssh" and int(rest.split()[1]) == server_pid:
            return int(stat.parent.name)
    raise AssertionError("there is no ssh")
