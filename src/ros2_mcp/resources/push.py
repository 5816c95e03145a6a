"""Notifications of subscribers: `resources/subscribe` of the handshake era, `subscriptions/listen` of the modern era.

A client that reads slowly is notified once, later: its mailbox holds each event at most once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from mcp.server.context import ServerRequestContext
from mcp.server.session import ServerSession
from mcp.server.subscriptions import SUBSCRIPTION_ID_META_KEY, ResourceUpdated, ServerEvent, SubscriptionBus
from mcp.shared.exceptions import MCPError
from mcp.shared.subscriptions import event_matches, event_to_notification
from mcp.types import (
    INVALID_PARAMS,
    INVALID_REQUEST,
    EmptyResult,
    NotificationParams,
    SubscribeRequestParams,
    SubscriptionFilter,
    SubscriptionsAcknowledgedNotification,
    SubscriptionsAcknowledgedNotificationParams,
    SubscriptionsListenRequestParams,
    SubscriptionsListenResult,
    UnsubscribeRequestParams,
)

from ros2_mcp.model.errors import RobotError
from ros2_mcp.model.text import visible
from ros2_mcp.ops.watch.watchers import Subject, Watcher

# The most URIs watched by one client: several times what any client was seen to watch. Each may be a subscription on
# the robot.
MAX_URIS = 200
# The most open `subscriptions/listen` requests: each costs a task and a mailbox, and requests that are never ended must
# not accumulate.
MAX_LISTENING = 256

Request = ServerRequestContext[Any, Any]


class Mailbox:
    """Events for one client, each at most once, in the order of their first arrival."""

    def __init__(self) -> None:
        self._events: dict[ServerEvent, None] = {}
        self._arrived = asyncio.Event()

    def put(self, event: ServerEvent) -> None:
        """Add an event. Never waits."""
        self._events[event] = None
        self._arrived.set()

    async def take(self) -> ServerEvent:
        """Wait for an event, and remove and return the oldest."""
        while not self._events:
            self._arrived.clear()
            await self._arrived.wait()
        event = next(iter(self._events))
        del self._events[event]
        return event


class Subscriber:
    """A client of the handshake era: the URIs that it watches, and its mailbox."""

    def __init__(self) -> None:
        self.watched: dict[str, Callable[[], None]] = {}
        self.mailbox = Mailbox()

    async def notify(self, session: ServerSession) -> None:
        """Send the client its notifications, until cancelled."""
        while True:
            event = await self.mailbox.take()
            if isinstance(event, ResourceUpdated) and event.uri in self.watched:
                await session.send_resource_updated(event.uri)

    def leave(self) -> None:
        """Stop watching everything."""
        for leave in self.watched.values():
            leave()
        self.watched.clear()


class Push:
    """Answers the subscription methods of both eras."""

    def __init__(self, watched: Callable[[str], tuple[Watcher, Subject]], bus: SubscriptionBus) -> None:
        """`watched` returns the watcher and subject of a URI, and raises a `RobotError` for an unknown URI."""
        self._watched = watched
        self._bus = bus
        self._subscribers: dict[int, Subscriber] = {}
        self._listening = 0

    async def initialized(self, request: Request, _: NotificationParams) -> None:
        """Handle `notifications/initialized` of the handshake era; it lasts as long as the client is connected.

        The SDK runs the handlers of a connection in one task group, and cancels them when it ends: no other public
        interface shows that a client has gone. A client is identified by the parameters of its `initialize`, which are
        the same object for all requests of its connection. `mcp/leases.py` ends the motion of a client that has gone.
        """
        client = request.session.client_params
        if id(client) in self._subscribers:
            return
        subscriber = self._subscribers[id(client)] = Subscriber()
        try:
            await subscriber.notify(request.session)
        finally:
            subscriber.leave()
            del self._subscribers[id(client)]

    async def subscribe(self, request: Request, params: SubscribeRequestParams) -> EmptyResult:
        """Subscribe a client of the handshake era. The answer is sent when no later change can be missed.

        Raises:
            MCPError: for an unknown URI, too many subscriptions, or a client that has not sent
                `notifications/initialized`.
        """
        uri, subscriber = str(params.uri), self._subscriber(request)
        try:
            watcher, subject = self._watched(uri)
        except RobotError as error:
            raise MCPError(INVALID_PARAMS, visible(str(error)), data={"uri": visible(uri)}) from error
        if len(subscriber.watched) >= MAX_URIS:
            raise MCPError(INVALID_PARAMS, f"You are subscribed to {MAX_URIS} resources: unsubscribe from some first.")
        if uri not in subscriber.watched:
            subscriber.watched[uri] = _watch(uri, watcher, subject, subscriber.mailbox)
            await watcher.begun(subject)
        return EmptyResult()

    async def unsubscribe(self, request: Request, params: UnsubscribeRequestParams) -> EmptyResult:
        """Unsubscribe a client of the handshake era. No effect if there is no such subscription."""
        leave = self._subscriber(request).watched.pop(str(params.uri), None)
        if leave:
            leave()
        return EmptyResult()

    async def listen(self, request: Request, params: SubscriptionsListenRequestParams) -> SubscriptionsListenResult:
        """Acknowledge a subscription of the modern era with the parts of it that are supported, then send events until
        the request is cancelled.
        """
        if self._listening >= MAX_LISTENING:
            raise MCPError(INVALID_PARAMS, f"{MAX_LISTENING} subscriptions are open: end some first.")
        asked = params.notifications
        uris = list(dict.fromkeys(asked.resource_subscriptions or ()))
        if len(uris) > MAX_URIS:
            raise MCPError(INVALID_PARAMS, f"{len(uris)} resources are too many: at most {MAX_URIS}.")
        subjects = {uri: found for uri in uris if (found := self._watched_or_none(uri)) is not None}
        honored = SubscriptionFilter(
            tools_list_changed=asked.tools_list_changed or None,
            prompts_list_changed=asked.prompts_list_changed or None,
            resources_list_changed=asked.resources_list_changed or None,
            resource_subscriptions=list(subjects) or None,
        )
        mailbox, own_uris = Mailbox(), frozenset(subjects)

        def deliver(event: ServerEvent) -> None:
            if event_matches(honored, own_uris, event):
                mailbox.put(event)

        self._listening += 1
        try:
            with ExitStack() as until_the_end:
                until_the_end.callback(self._bus.subscribe(deliver))
                for uri, (watcher, subject) in subjects.items():
                    until_the_end.callback(_watch(uri, watcher, subject, mailbox))
                # Waited for together: several robots that are away delay the answer no longer than one.
                await asyncio.gather(*(watcher.begun(subject) for watcher, subject in subjects.values()))
                await _notify_listener(request, honored, mailbox)
        finally:
            self._listening -= 1
        return SubscriptionsListenResult()

    def _subscriber(self, request: Request) -> Subscriber:
        subscriber = self._subscribers.get(id(request.session.client_params))
        if subscriber is None:
            raise MCPError(INVALID_REQUEST, "Send notifications/initialized before you subscribe to resources.")
        return subscriber

    def _watched_or_none(self, uri: str) -> tuple[Watcher, Subject] | None:
        try:
            return self._watched(uri)
        except RobotError:
            return None


def _watch(uri: str, watcher: Watcher, subject: Subject, mailbox: Mailbox) -> Callable[[], None]:
    return watcher.watch(subject, lambda: mailbox.put(ResourceUpdated(uri)))


async def _notify_listener(request: Request, honored: SubscriptionFilter, mailbox: Mailbox) -> None:
    stamp: dict[str, Any] = {SUBSCRIPTION_ID_META_KEY: request.request_id}
    acknowledgement = SubscriptionsAcknowledgedNotificationParams(notifications=honored, _meta=stamp)
    await request.session.send_notification(
        SubscriptionsAcknowledgedNotification(params=acknowledgement), related_request_id=request.request_id
    )
    while True:
        event = await mailbox.take()
        await request.session.send_notification(
            event_to_notification(event, stamp), related_request_id=request.request_id
        )
