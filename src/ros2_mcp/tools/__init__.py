"""What the model sees: one module per family of tools, listed here in the order of `tools/list`."""

from ros2_mcp.tools import graph, publishing, topics
from ros2_mcp.tools.declare import TOOLS, ToolDeclaration

__all__ = ["TOOLS", "ToolDeclaration", "graph", "publishing", "topics"]
