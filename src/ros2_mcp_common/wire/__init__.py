"""What crosses between server and bridge: packets, their pieces, the types of requests and replies, and every limit."""
