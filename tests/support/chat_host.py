"""A chat host for the tests: a web page that shows our page in a frame as hosts do, and passes on what it calls.

What the host does is in `chat_host.html`; what it asks the server goes through a real MCP client. It listens at two
ports: the second is the foreign origin from which hosts show pages.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

from mcp.client.extension import advertise

from support.agent import Agent

APPS = advertise("io.modelcontextprotocol/ui", {"mimeTypes": ["text/html;profile=mcp-app"]})
"""What a client says that shows pages."""
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "media-src 'self' data:; connect-src 'none'; object-src 'none'"
)
"""Of a page that declares none, word for word from the specification."""
KINDS = ("srcdoc", "blob", "origin", "double")
"""How hosts frame a page: as text, as a blob, from another origin, and in two frames within each other."""


class ChatHost:
    """`address` is the host's page. `asked` are the calls that came from it, in order."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        self.address = self.elsewhere = ""
        tool = agent.tools()["ros2_view"]
        uri = tool.meta["ui"]["resourceUri"]
        (content,) = agent.ask("read_resource", uri).contents
        self.html: str = content.text
        self.visible = {name: (one.meta or {})["ui"]["visibility"] for name, one in agent.tools().items()}

    def answer(self, path: str, body: Mapping[str, Any]) -> Mapping[str, Any]:
        """What the host asks of the server: as the model (`/model`), or in place of the page (`/page`)."""
        name, arguments = str(body["name"]), body["arguments"]
        who = "model" if path == "/model" else "app"
        if who not in self.visible.get(name, ()):
            raise ValueError(f"{name} is not for the {who}")
        self.asked.append((name, arguments))
        return self._agent.whole(name, dict(arguments)).model_dump(mode="json", by_alias=True, exclude_none=True)

    def page(self, path: str) -> tuple[str, str] | None:
        """A page and its policy."""
        own = Path(__file__).with_suffix(".html").read_text("utf-8")
        pages = {
            "/": (own.replace("@ELSEWHERE@", self.elsewhere).replace("@POLICY@", POLICY), ""),
            "/view": (self.html, POLICY),
            "/outer": (_OUTER, ""),
            "/html": (self.html, ""),
        }
        return pages.get(path)


_OUTER = """<!doctype html><style>html,body,iframe{margin:0;width:100%;height:100%;border:0}</style><script>
const inner = document.createElement("iframe");
addEventListener("message", (event) => {
  if (event.source !== parent) parent.postMessage(event.data, "*");
  else if (event.data.method === "ui/notifications/sandbox-resource-ready") {
    inner.setAttribute("sandbox", "allow-scripts"); inner.srcdoc = event.data.params.html; document.body.append(inner);
  } else inner.contentWindow.postMessage(event.data, "*");
});
const ready = {jsonrpc: "2.0", method: "ui/notifications/sandbox-proxy-ready", params: {}};
addEventListener("load", () => parent.postMessage(ready, "*"));
</script><body></body>"""


@contextmanager
def hosting(agent: Agent) -> Iterator[ChatHost]:
    """A host at two ports, for the time of a block."""
    host = ChatHost(agent)
    servers = [ThreadingHTTPServer(("127.0.0.1", 0), _answering(host)) for _ in range(2)]
    host.address, host.elsewhere = (f"http://127.0.0.1:{server.server_port}" for server in servers)
    threads = [threading.Thread(target=server.serve_forever, args=(0.05,)) for server in servers]
    for thread in threads:
        thread.start()
    try:
        yield host
    finally:
        for server in servers:
            server.shutdown()
            server.server_close()
        for thread in threads:
            thread.join()


def _answering(host: ChatHost) -> Callable[..., BaseHTTPRequestHandler]:
    class Answering(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = host.page(urlparse(self.path).path)
            html, policy = found or ("", "")
            headers = {"content-type": "text/html; charset=utf-8"}
            self._send(
                200 if found else 404, html.encode(), headers | ({"content-security-policy": policy} if policy else {})
            )

        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])))
            try:
                status, answer = 200, host.answer(self.path, body)
            except Exception as error:  # noqa: BLE001 - as hosts do: what fails is told to the page
                status, answer = 500, {"message": str(error)}
            self._send(status, json.dumps(answer).encode(), {"content-type": "application/json"})

        def _send(self, status: int, body: bytes, headers: Mapping[str, str]) -> None:
            self.send_response(status)
            for name, value in {**headers, "content-length": str(len(body))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Says nothing."""

    return Answering
