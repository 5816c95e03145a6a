"""Topics and services: subscriptions, publishers, relays, and calls of services and actions."""
