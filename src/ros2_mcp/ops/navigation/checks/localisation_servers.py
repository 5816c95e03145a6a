"""The servers of localisation, before all that follows from them: without them there is no map, and no place in it."""

from __future__ import annotations

from ros2_mcp.ops.navigation.checks.check import LOCALISER, NavCheck
from ros2_mcp.ops.navigation.checks.servers import of_localisation

CHECK = NavCheck(("states", "parameters", "log"), of_localisation, LOCALISER)
