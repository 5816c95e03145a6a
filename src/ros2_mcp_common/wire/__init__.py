"""The protocol between server and bridge: packets, their pieces, the types of requests and replies, and all limits."""
