# pyright: basic
"""Last wills: what is done when the stream ends, whatever ends it."""

from __future__ import annotations

import sys
from functools import partial

from .request import Cancelled

HOLD_S = 3600.0


class Wills:
    """Each will is a request that stays open; it is withdrawn by cancelling it."""

    def __init__(self, publishers, clients):
        self._publishers = publishers
        self._clients = clients
        self._deeds = {}

    def __len__(self):
        return len(self._deeds)

    def publish(self, request):
        """A message to publish at the end."""
        with self._publishers.use(request) as (publisher, _):
            yield from self._hold(request, partial(_publish_twice, publisher, request.body))

    def call(self, request):
        """A request to send to a service at the end."""
        with self._clients.use(request) as (client, message):
            yield from self._hold(request, partial(_call, client, message))

    def carry_out(self):
        """Do it all; returns the futures of the calls. Another thread may call it when the ROS thread is stuck."""
        futures = []
        while self._deeds:
            deed = self._deeds.popitem()[1]
            try:
                futures.append(deed())
            except Exception as error:  # noqa: BLE001 - one that fails must not keep the others from being done
                sys.stderr.write(f"a last will could not be carried out: {error}\n")
        return [future for future in futures if future is not None]

    def _hold(self, request, deed):
        self._deeds[request.id] = deed
        try:
            while True:
                yield HOLD_S
        except Cancelled:
            return {"cancelled": True}
        finally:
            self._deeds.pop(request.id, None)


def _publish_twice(publisher, body):
    """Twice, for best-effort subscribers."""
    publisher.publish(body)
    publisher.publish(body)


def _call(client, message):
    return client.call_async(message) if client.service_is_ready() else None
