"""Add a token to a file of tokens, and print it once."""

# ruff: noqa: T201 - printing is this module's job

from __future__ import annotations

import sys
from collections.abc import Sequence

from ros2_mcp.guard.tokens import add_token
from ros2_mcp.model.errors import BadInput
from ros2_mcp.settings import Settings


def print_token(settings: Settings, name: str, scopes: Sequence[str]) -> int:
    """Print the new token on stdout, and its use on stderr.

    Raises:
        BadInput: without a file of tokens, or for an invalid name or scope.
    """
    if not settings.token_file:
        raise BadInput("A file of tokens is needed.", f"Such as: ros2-mcp --token-file tokens token {name}")
    path = settings.token_file.expanduser()
    token = add_token(path, name, scopes)
    print(f"# {name} may {', '.join(scopes)}; {path} keeps its SHA-256 alone. This is shown once:", file=sys.stderr)
    print(token)
    print("# Servers read their tokens at their start.", file=sys.stderr)
    return 0
