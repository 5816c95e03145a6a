"""Topics and clients: the graph, subscriptions, publishers, relays, and calls of services and actions."""
