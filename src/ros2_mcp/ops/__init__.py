"""The operations on a robot: plain async functions with dataclass results, without MCP."""
