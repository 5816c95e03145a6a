"""MCP: the server, its tools as clients meet them, completions, approvals and apps."""
