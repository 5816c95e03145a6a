"""The floor of MCP: one trivial tool on the bare SDK over stdio."""

from mcp.server.mcpserver import MCPServer

server = MCPServer("trivial")


@server.tool()
async def ping(text: str = "") -> str:
    """Answer with the same text."""
    return text


if __name__ == "__main__":
    server.run("stdio")
