"""The graph as a whole: status, interfaces, names."""
