"""What a robot can do: plain async functions with dataclass results, no MCP."""
