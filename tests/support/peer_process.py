"""The peers of the tests: processes forked by `commands_peer`."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from support.agent import Agent, Refusal
from support.processes import peer_command

COMMAND_S = 60.0
LEAVES_S = 15.0
"""Far more than a participant takes to say goodbye; Fast DDS 2.14 deadlocks in it now and then, and is then ended."""
KNOWN_S = 45.0
"""How long the middleware may take until two processes know each other, on a busy machine."""
SPARES = 2
_NUMBERS = itertools.count(1)


class Nursery:
    """A process that has imported ROS and forks peers.

    Two processes need up to 3 s until they know each other, so some are started in advance.
    """

    def __init__(self, environment: dict[str, str]) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(peer_command("commands_peer"), stdin=theirs, env=environment)
        self._spares = deque(self._fork() for _ in range(SPARES))

    def start(self, *roles: str, namespace: str = "", is_new: bool = False) -> PeerProcess:
        """A peer; nobody knows its process yet if it `is_new`, and else perhaps."""
        self._spares.append(self._fork())
        peer = self._spares.pop() if is_new else self._spares.popleft()
        return peer.become(namespace or f"/peer{next(_NUMBERS)}", *roles)

    def close(self) -> None:
        """End it; peers that are left end too, since nobody commands them any more."""
        self._socket.close()
        self._process.wait(30)
        for spare in self._spares:
            spare.leave()

    def _fork(self) -> PeerProcess:
        ours, theirs = socket.socketpair()
        with theirs:
            socket.send_fds(self._socket, [b"."], [theirs.fileno()])
        return PeerProcess(ours)


class PeerProcess:
    """One peer under a namespace of its own; its commands are methods: `peer.count(name="switch")`."""

    def __init__(self, commands: socket.socket) -> None:
        self.namespace = ""
        self._pid = 0
        self._commands = commands
        self._commands.settimeout(COMMAND_S)
        self._lines = commands.makefile("rw")

    def become(self, namespace: str, *roles: str) -> PeerProcess:
        """Let it offer what these roles offer; returns when it does."""
        self.namespace, self._pid = namespace, self._answer()
        self._say([namespace, *roles])
        assert self._answer() == "ready"
        return self

    def name(self, relative: str) -> str:
        """The full name of something that it offers."""
        return f"{self.namespace}/{relative}"

    def __getattr__(self, command: str) -> Callable[..., Any]:
        def ask(**arguments: Any) -> Any:
            self._say([command, arguments])
            return self._answer()

        return ask

    def leave(self) -> None:
        """Let it end as a ROS node should; nothing happens if it has ended already."""
        if self._lines.closed:
            return
        with suppress(AssertionError):  # it died before
            self._pid = self._pid or self._answer()
            self._commands.shutdown(socket.SHUT_WR)
            self._commands.settimeout(LEAVES_S)
        try:
            self._has_ended()
        except TimeoutError:
            os.kill(self._pid, signal.SIGKILL)
            self._close()

    def terminate(self) -> None:
        """End it with SIGTERM: it leaves as a ROS node should."""
        os.kill(self._pid, signal.SIGTERM)
        self._has_ended()

    def kill(self) -> None:
        """End it without its saying goodbye to ROS."""
        os.kill(self._pid, signal.SIGKILL)
        self._has_ended()

    def _has_ended(self) -> None:
        with suppress(ConnectionError):
            while self._lines.readline():
                pass
        self._close()

    def _close(self) -> None:
        self._lines.close()
        self._commands.close()

    def _say(self, value: Any) -> None:
        print(json.dumps(value), file=self._lines, flush=True)

    def _answer(self) -> Any:
        line = self._lines.readline()
        assert line, "the peer died"
        return json.loads(line)


def reachable(agent: Agent, nursery: Nursery, *roles: str, **options: Any) -> PeerProcess:
    """A peer, as soon as it and the server under test know each other: a call has been answered.

    With the shared memory of Fast DDS, about one in a hundred processes that take the place of a killed one is deaf for
    ever. Where an independent node does not get an answer from it either, another one is started.
    """
    peer = nursery.start(*roles, **options)
    deadline = time.monotonic() + KNOWN_S
    while not _answers(agent, peer):
        if time.monotonic() > deadline:
            witness = nursery.start()
            assert not witness.reaches(service=peer.name("there")), f"only we do not reach {peer.namespace}"
            witness.leave()
            peer.leave()
            print(f"{peer.namespace} was deaf")
            return reachable(agent, nursery, *roles, **options)
    return peer


def _answers(agent: Agent, peer: PeerProcess) -> bool:
    there = {"service_name": peer.name("there"), "service_type": "std_srvs/srv/SetBool", "fields": {"data": True}}
    try:
        return agent.call("ros2_service_call", timeout_sec=1.0, **there)["called"]
    except Refusal:
        return False
