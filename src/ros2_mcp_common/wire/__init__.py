"""What crosses between server and bridge: packets, their pieces, the operations, and every limit."""
