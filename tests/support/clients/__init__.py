"""Real MCP clients in front of the server, with a scripted model on loopback in the place of a real one."""
