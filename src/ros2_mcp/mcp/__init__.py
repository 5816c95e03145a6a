"""MCP: the server, the tools as clients see them, completions, approvals and apps."""
