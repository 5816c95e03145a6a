"""The transports for clients: standard streams, a Unix socket, HTTP."""
