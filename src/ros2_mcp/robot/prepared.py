"""A command on its way out, with its bytes: its value is checked and encoded once."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from ros2_mcp.model.commands import Command, Move, Publish, Repeat, SendGoal, ServiceBorne
from ros2_mcp.model.errors import BadValue
from ros2_mcp.robot.session import Session
from ros2_mcp.robot.values import Values

C = TypeVar("C", bound=Command[Any])
Other = TypeVar("Other", bound=Command[Any])


class Prepared(Generic[C]):
    """A command, and the session in which it is given. Policy, audit and executor get the same bytes, which are made
    when one of them first asks for them.
    """

    def __init__(self, values: Values, session: Session, command: C, body: bytes | None = None) -> None:
        self.session = session
        self.command = command
        self._values = values
        self._body = body
        self._full: dict[str, Any] | None = None

    @property
    def has_value(self) -> bool:
        """Whether it sends a value of its own: a message, or the request to a service."""
        return isinstance(self.command, ServiceBorne | Publish | Repeat | Move)

    async def body(self) -> bytes:
        """The value as CDR bytes.

        Raises:
            BadValue: naming the path of what does not fit the definition.
        """
        if self._body is None:
            try:
                self._body = await self._values.encode(*self._typed())
            except BadValue as error:
                if isinstance(self.command, SendGoal):  # the caller gave the goal, and not the request around it
                    raise error.below("goal") from error
                raise
        return self._body

    async def full(self) -> dict[str, Any]:
        """The whole value as it will be sent, defaults filled in: read from the bytes. Raises as `body`."""
        if self._full is None:
            self._full = await self._values.in_full(self._typed()[0], await self.body())
        return self._full

    def meaning(self, command: Other) -> Prepared[Other]:
        """Another command that stands for the same bytes."""
        return Prepared(self._values, self.session, command, self._body)

    def changed(self, command: C) -> Prepared[C]:
        """A command with another value."""
        return Prepared(self._values, self.session, command)

    def _typed(self) -> tuple[str, object]:
        """The type of the value, and the value as it was given."""
        if isinstance(self.command, ServiceBorne):
            return f"{self.command.service_type}_Request", self.command.request
        return self.command.type, self.command.value
