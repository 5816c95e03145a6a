"""The page: one committed file with script and style inside, built by `viewer/build.mjs`; without any data."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_PARTS = re.compile(rb"<(script|style)>(.*?)</\1>", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Page:
    """The bytes of the page, and the content security policy that allows only its own script and style."""

    html: bytes
    policy: str


@cache
def page() -> Page:
    """Return the page, read at the first call."""
    html = (Path(__file__).parent / "page.html").read_bytes()
    sources: dict[str, list[str]] = {"script": [], "style": []}
    for kind, body in _PARTS.findall(html):
        digest = base64.b64encode(hashlib.sha256(body).digest()).decode("ascii")
        sources[kind.decode("ascii")].append(f"'sha256-{digest}'")
    policy = {
        "default-src": "'none'",
        "script-src": " ".join(sources["script"]),
        "style-src": " ".join(sources["style"]),
        "img-src": "data:",
        "connect-src": "'self'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
        "require-trusted-types-for": "'script'",
    }
    return Page(html, "; ".join(f"{name} {value}" for name, value in policy.items()))
