"""Resources: what a client can read by URI, and be notified of when it changes."""

from ros2_mcp.resources.catalogue import RESOURCES, Declared
from ros2_mcp.resources.offering import Resources

__all__ = ["RESOURCES", "Declared", "Resources"]
