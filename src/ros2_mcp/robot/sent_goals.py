"""The goals that this server has sent, and must be able to cancel: jobs that the robot carries out."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from ros2_mcp.model.commands import Principal
from ros2_mcp.robot.jobs import Job


class Goal(Job):
    """A goal that this server sent, known until it is seen to end; its id is the goal's own.

    `is_accepted` is false as long as its server has not said that it takes it, and so may know nothing of it.
    """

    kind = "goal"
    most_running = 1000
    """Those that nobody follows to their end would otherwise be kept for ever."""
    most_kept = 1000
    is_displaced = True
    ends_elsewhere = True
    stopped_by = "ros2_cancel_action_goal"

    def __init__(
        self,
        *,
        owner: Principal,
        goal_id: str,
        action: str,
        action_type: str,
        ask_to_cancel: Callable[[], Awaitable[object]],
    ) -> None:
        super().__init__(owner=owner, moves=[action], job_id=goal_id)
        self.action = action
        self.action_type = action_type
        self.is_accepted = False
        self._ask_to_cancel = ask_to_cancel
        self._has_ended = asyncio.Event()

    async def run(self) -> None:
        """Waits until somebody has seen it end."""
        self.begun()
        await self._has_ended.wait()

    async def stop(self) -> None:
        """Asks its server to cancel it. It stays known until it is seen to end, as it may move the robot until then."""
        if self.is_stopping:  # it has been given up: the bridge's fail-safe cancels it
            await self.wait()
        elif self.is_running:
            await self._ask_to_cancel()

    def has_been_seen_to_end(self) -> None:
        """Notes that it has ended, or was not accepted."""
        self._has_ended.set()

    @property
    def is_running(self) -> bool:
        """Whether it has not been seen to end."""
        return super().is_running and not self._has_ended.is_set()
