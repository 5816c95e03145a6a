"""The tree of frames, with the publisher, rate, age and problems of each edge."""

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
    """Shows all coordinate frames, each below its parent, as `ros2_tf_tree` returns them."""

    name = "frames"
    period_s = 1.0
    """Rates and ages are read now and then, not watched."""

    async def show(self, look: Look) -> Content | None:
        """Return the tree as known by now: it fills within seconds, so there is no waiting."""
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
        """Return the content in one line for the model."""
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
