"""A command on its way to the bridge, with its bytes: its value is checked and encoded once."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from ros2_mcp.model.commands import Command, Move, Publish, Repeat, SendGoal, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.values import Values

C = TypeVar("C", bound=Command[Any])
Other = TypeVar("Other", bound=Command[Any])


class Prepared(Generic[C]):
    """A command and its session. Policy, audit and execution use the same bytes, which are encoded at first use."""

    def __init__(self, values: Values, session: Session, command: C, body: bytes | None = None) -> None:
        self.session = session
        self.command = command
        self._values = values
        self._body = body
        self._full: dict[str, Any] | None = None

    @property
    def has_value(self) -> bool:
        """Whether the command sends a value of its own: a message, or a request to a service."""
        return isinstance(self.command, ServiceBorne | Publish | Repeat | Move)

    async def body(self) -> bytes:
        """Return the value as CDR bytes.

        Raises:
            BadValue: with the path of the field that does not fit the definition.
        """
        if self._body is None:
            try:
                self._body = await self._values.encode(*self._typed())
            except BadValue as error:
                if isinstance(self.command, SendGoal):  # the caller gave the goal, without the request around it
                    raise error.below("goal") from error
                raise
        return self._body

    async def full(self) -> dict[str, Any]:
        """Return the whole value as it will be sent, including defaults, decoded from the bytes. Raises as `body`."""
        if self._full is None:
            self._full = await self._values.in_full(self._typed()[0], await self.body())
        return self._full

    def meaning(self, command: Other) -> Prepared[Other]:
        """Return another command with the same bytes."""
        return Prepared(self._values, self.session, command, self._body)

    def changed(self, command: C) -> Prepared[C]:
        """Return the command with another value."""
        return Prepared(self._values, self.session, command)

    def _typed(self) -> tuple[str, object]:
        """Return the type of the value, and the value as given."""
        if isinstance(self.command, ServiceBorne):
            return f"{self.command.service_type}_Request", self.command.request
        return self.command.type, self.command.value
