"""The servers of localisation, checked before all that depends on them: without them there is no map and no pose."""

from __future__ import annotations

from ros2_mcp.ops.navigation.checks.check import LOCALISER, NavCheck
from ros2_mcp.ops.navigation.checks.servers import of_localisation

CHECK = NavCheck(("states", "parameters", "log"), of_localisation, LOCALISER)
