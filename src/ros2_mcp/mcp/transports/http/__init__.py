"""MCP over HTTP: login, scopes, sessions, and the leases of clients."""
