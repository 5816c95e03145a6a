"""The robots of one server: their tools in one list, and the tools for all robots together."""

from ros2_mcp.mcp.fleet.fleet import Fleet
from ros2_mcp.mcp.fleet.member import Member

__all__ = ["Fleet", "Member"]
