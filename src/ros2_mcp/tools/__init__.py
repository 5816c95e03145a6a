"""What the model sees: one module per family of tools, listed here in the order of `tools/list`."""

from ros2_mcp.tools import actions, graph, parameters, publishing, services, stop, topics
from ros2_mcp.tools.declare import TOOLS, ToolDeclaration

__all__ = ["TOOLS", "ToolDeclaration", "actions", "graph", "parameters", "publishing", "services", "stop", "topics"]
