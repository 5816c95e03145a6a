"""Problems of frames as in `ros2_tf_tree`: NaN, two publishers, refused or stale edges, several trees."""

from __future__ import annotations

from collections.abc import Iterator

from ros2_mcp.ops.measure.checks.check import Check
from ros2_mcp.ops.measure.evidence import Evidence
from ros2_mcp.ops.measure.findings import Finding

_ADVICE = "ros2_tf_tree shows all frames, with their publishers."


def _find(evidence: Evidence) -> Iterator[Finding]:
    for found in evidence.frames or ():
        yield Finding("warning", "frames", found.problem, _ADVICE, found.publisher)


CHECK = Check(("frames",), _find)
