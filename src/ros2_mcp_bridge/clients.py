# pyright: basic
"""Service calls: request bytes in, response bytes out, many at once."""

from __future__ import annotations

import time
from contextlib import contextmanager
from functools import partial

from rclpy.serialization import deserialize_message, serialize_message

from .pool import Pool
from .request import OperationError

POLL_S = 0.1
APPEARS_POLL_S = 0.005
GONE_AFTER_S = 0.3


class Clients:
    """Pooled clients of services, those of actions included."""

    def __init__(self, node):
        self._node = node
        self.pool = Pool(node.destroy_client)

    def call(self, request):
        """Send a request and wait for its response."""
        service = request.text("service")
        wait_s, timeout_s = request.number("wait_s", 0.0), request.number("timeout_s")
        started = time.monotonic()
        latest = started + request.number("within_s", wait_s + timeout_s)
        with self.use(request) as (client, message):
            yield from _wait_server(client, service, wait_s)
            sent_at = time.monotonic()
            future = client.call_async(message)
            future.add_done_callback(lambda _: request.wake())
            try:
                yield from _wait_response(client, service, future, timeout_s, latest)
            finally:
                client.remove_pending_request(future)
            body = serialize_message(future.result())
        elapsed_s = round(time.monotonic() - sent_at, 6)
        return {"waited_s": round(sent_at - started, 6), "elapsed_s": elapsed_s}, body

    def unserved(self):
        """The services that we have a client of and nobody serves."""
        return {client.srv_name for client in self.pool.values() if not client.service_is_ready()}

    @contextmanager
    def use(self, request):
        """The pooled client of the service that a request names, and the message to send."""
        message, interface, service = _deserialize(request), request.interface, request.text("service")
        create = partial(self._node.create_client, interface, service)
        with self.pool.use((service, interface), create) as (client, _):
            yield client, message


def _deserialize(request):
    try:
        return deserialize_message(request.body, request.interface.Request)
    except Exception as error:  # the middlewares raise errors of many kinds
        message = f"{request.op}: the body is no request of {request.text('type')}: {error}"
        raise OperationError("bad_request", message) from error


def _wait_server(client, service, wait_s):
    deadline = time.monotonic() + wait_s
    while not client.service_is_ready():
        if time.monotonic() >= deadline:
            raise OperationError("not_found", f"No server of {service} appeared within {wait_s:g} s.")
        yield APPEARS_POLL_S


def _wait_response(client, service, future, timeout_s, latest):
    deadline = min(time.monotonic() + timeout_s, latest)
    last_ready = time.monotonic()
    while not future.done():
        now = time.monotonic()
        if client.service_is_ready():
            last_ready = now
        if now - last_ready > GONE_AFTER_S:
            raise OperationError("server_gone", f"The server of {service} disappeared before it answered.")
        if now >= deadline:
            raise OperationError("timeout", f"{service} did not answer within {timeout_s:g} s.")
        yield min(POLL_S, deadline - now)
