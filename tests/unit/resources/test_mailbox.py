"""A client that does not read costs no more than one event of each kind."""

from __future__ import annotations

import asyncio

from mcp.server.subscriptions import ResourceUpdated

from ros2_mcp.resources.push import Mailbox


async def test_an_event_that_waits_already_is_not_added() -> None:
    mailbox = Mailbox()
    for uri in ("ros2://a", "ros2://b", "ros2://a") * 1000:
        mailbox.put(ResourceUpdated(uri))
    first = [await mailbox.take(), await mailbox.take()]
    late = asyncio.ensure_future(mailbox.take())
    await asyncio.sleep(0.01)
    assert not late.done()
    mailbox.put(ResourceUpdated("ros2://a"))
    assert [*first, await asyncio.wait_for(late, 20.0)] == [
        ResourceUpdated("ros2://a"),
        ResourceUpdated("ros2://b"),
        ResourceUpdated("ros2://a"),
    ]
