"""The tree of frames, with who tells each edge, how often, how long ago, and what is wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ros2_mcp.ops.space.edges import EdgeRow
from ros2_mcp.ops.space.tf_tree import tf_tree
from ros2_mcp.view.look import MOST_NAMED, Content, Look, Panel

_MOST_EDGES = 400
"""The largest robots have some 150."""
_MOST_PROBLEMS = 20


class FramesPanel(Panel):
    """All coordinate frames, each below its parent; as `ros2_tf_tree` tells them."""

    name = "frames"
    period_s = 1.0
    """Rates and ages are read, not watched."""

    async def show(self, look: Look) -> Content | None:
        """The tree as it is known by now: it fills within seconds, and nothing is waited for."""
        tree = await tf_tree(look.source, duration_s=0.0, picture=False)
        left_out = len(tree.edges) - _MOST_EDGES
        notes = [tree.note] if tree.note else []
        if left_out > 0:
            notes.append(f"{left_out} more frames are not shown.")
        return {
            "frames": tree.frames,
            "roots": list(tree.roots[:_MOST_EDGES]),
            "edges": [_told(row) for row in tree.edges[:_MOST_EDGES]],
            "problems": list(tree.problems[:_MOST_PROBLEMS]),
            "notes": notes,
            "at_s": look.now_ns / 1e9,
        }

    def words(self, content: Content) -> str:
        """As the agent reads it."""
        if "frames" not in content:
            return ""
        problems = [str(text) for text in content.get("problems") or ()]
        return f"{content['frames']} frames, {' '.join(problems[:MOST_NAMED]) or 'no problem'}"


def _told(row: EdgeRow) -> Mapping[str, Any]:
    return {
        "parent": row.parent,
        "child": row.child,
        "static": row.is_static,
        "publisher": row.publisher,
        "rate_hz": row.rate_hz,
        "age_s": None if row.age_s is None else round(max(row.age_s, 0.0), 2),
        "problem": row.problem,
    }
