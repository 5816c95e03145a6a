"""Approvals by form elicitation, if all policies in force accept it: the client asks its user (decision 31).

The client only claims who has answered, and the audit says so. A client of the handshake era is asked while its call is
open; a client of the modern era gets the question as the result, and repeats its call with the answer. The approval is
like an operator's: for exactly that command, used once, even if the client repeats the answer.
"""

from __future__ import annotations

from typing import Any

import anyio
from mcp.server.context import ServerRequestContext
from mcp.shared.exceptions import MCPError
from mcp.types import (
    CallToolRequestParams,
    ElicitRequest,
    ElicitRequestFormParams,
    ElicitResult,
    InputRequiredResult,
)
from mcp_types.version import MODERN_PROTOCOL_VERSIONS

from ros2_mcp.guard.approvals import Approvals, Request
from ros2_mcp.guard.consent import Consent
from ros2_mcp.model.commands import Principal
from ros2_mcp.model.errors import ApprovalNeeded, NotFound
from ros2_mcp.robot import Robot

_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {"approve": {"type": "boolean", "title": "Approve", "description": "Allow this once."}},
    "required": ["approve"],
}
_ASKED_S = 45.0
"""How long a call waits for the answer: less than the minute after which clients give up. An operator can still answer
later.
"""
_KEY = "approve-"
"""Prefix of the name of a question; the nonce follows."""

Context = ServerRequestContext[Any, Any]


class Elicitation:
    """The questions that one call raises. They name the robot if `name` is not empty."""

    def __init__(self, robot: Robot, principal: Principal, context: Context, name: str = "") -> None:
        consent = robot.guard.approvals
        documents = robot.policy.documents
        is_accepted = bool(documents) and all(document.consent.how == "elicitation" for document in documents)
        self._approvals = consent.approvals if is_accepted and isinstance(consent, Consent) else None
        self._context = context
        self._lead = f"Robot {name}:\n" if name else ""
        self._principal = principal
        self._by = f"user of the client {principal.name} (claimed)"

    def take_answers(self, params: CallToolRequestParams) -> None:
        """Take the answers in a repeated call of the modern era. Answers that come too late are ignored."""
        if self._approvals is None:
            return
        for key, answer in (params.input_responses or {}).items():
            request = self._waiting(key.removeprefix(_KEY)) if key.startswith(_KEY) else None
            if request and isinstance(answer, ElicitResult):
                self._answer(self._approvals, request, answer)

    async def put_to_user(self, error: BaseException | None) -> InputRequiredResult | bool:
        """Ask the user, if the call failed because an approval is needed and the client can ask.

        Returns:
            The question as a result, in the modern era; otherwise, whether the command was approved, so that the call
            has to be repeated.
        """
        if self._approvals is None or not isinstance(error, ApprovalNeeded) or not self._can_ask():
            return False
        try:
            request = self._approvals.find(error.request_id)
        except NotFound:
            return False
        message = self._lead + "\n".join(request.summary())
        if self._context.protocol_version in MODERN_PROTOCOL_VERSIONS:
            form = ElicitRequestFormParams(message=message, requested_schema=_SCHEMA)
            return InputRequiredResult(input_requests={f"{_KEY}{request.nonce}": ElicitRequest(params=form)})
        with anyio.move_on_after(_ASKED_S):
            try:
                answer = await self._context.session.elicit_form(message, _SCHEMA, self._context.request_id)
            except MCPError:  # the connection cannot carry requests, or the client cannot answer them
                return False
            still = self._waiting(request.nonce)
            return still is not None and self._answer(self._approvals, still, answer)
        return False

    def _can_ask(self) -> bool:
        """Return whether the client supports forms. `elicitation: {}`, the only shape before there were modes, means
        forms.
        """
        declared = self._context.session.client_capabilities
        able = declared.elicitation if declared else None
        return able is not None and (able.form is not None or able.url is None)

    def _waiting(self, nonce: str) -> Request | None:
        """Return the request with this nonce that still waits, if this client made it; else None."""
        waiting = self._approvals.waiting() if self._approvals else ()
        return next((one for one in waiting if one.nonce == nonce and one.exact.principal == self._principal), None)

    def _answer(self, approvals: Approvals, request: Request, answer: ElicitResult) -> bool:
        if answer.action == "accept" and (answer.content or {}).get("approve") is True:
            approvals.approve(request.id, request.nonce, by=self._by)
            return True
        if answer.action != "cancel":  # cancelling is no decision: an operator may still answer
            approvals.deny(request.id, request.nonce, by=self._by)
        return False
