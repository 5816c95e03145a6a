"""How clients connect: standard streams, a Unix socket, HTTP."""
