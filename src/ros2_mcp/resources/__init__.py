"""Resources: data that a client can read by URI, and whose changes it can be notified of."""

from ros2_mcp.resources.catalogue import RESOURCES, Declared
from ros2_mcp.resources.offering import Resources

__all__ = ["RESOURCES", "Declared", "Resources"]
