"""Find the node that publishes each edge if several nodes publish on /tf or /tf_static.

rclpy does not report the sender of a message. Known are: the present and former publishers; which messages come from
one publisher (by their sequence numbers, `values/writers.py`); what else each node publishes (the publisher of odom →
base also publishes odometry, that of map → odom a pose or a map); and the usual names of nodes. The result is an
inference and marked as such (`probably`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from ros2_mcp.model.qos import mismatch
from ros2_mcp.model.text import named
from ros2_mcp.ops.sources.source import Source
from ros2_mcp.robot.transforms import LISTENS, TF, TF_STATIC, TF_TYPE, Life
from ros2_mcp.world.frame_edges import Edge
from ros2_mcp.world.transforms import BASES, FrameTree

_SEEN_LATE_NS, _HEARD_LATE_NS = 3_000_000_000, 1_000_000_000
"""Tolerances in ns: a node may be discovered this long after its first message, and its last message be received this
long after it has left."""
_MOST_NAMED = 3
"""The most publishers named if it is not known which of them publishes an edge."""
_CALLED = {
    "localisation": re.compile(r"amcl|mcl|slam|locali[sz]|cartographer|rtabmap|map|hector|ndt|lio"),
    "odometry": re.compile(r"odom|diff|drive|base|ekf|ukf|state_estimat|wheel|kobuki|vio"),
    "description": re.compile(r"state_publisher|description|joint"),
}
"""Usual names of nodes by role: the names of Nav2, slam_toolbox, robot_localization, ros2_control and others."""
_LOCALISATION = "localisation"
GONE = ", which is gone"
_AS = {"placing": "localisation"}
"""A node that publishes the base directly in the map, without odom, is a localisation too."""
_CORRECTS = re.compile(r"amcl")
"""Matches localisation nodes that publish map → odom only."""


@dataclass(frozen=True, slots=True)
class Publishers:
    """The publishers of one topic: nodes that publish now, and nodes that did so since the subscription began and have
    left. `lives` is the time in which each may have been present, as far as it is known.
    """

    now: Sequence[str] = ()
    gone: Sequence[str] = ()
    lives: Mapping[str, Life] = field(default_factory=dict[str, Life])


class Tellers:
    """The publishers of frames, and the node that publishes each edge.

    Args:
        tree: the frame tree received.
        publishers: those of /tf and of /tf_static.
        also: by role, the nodes that publish other topics typical of that role.
    """

    def __init__(
        self, tree: FrameTree, publishers: Mapping[str, Publishers], also: Mapping[str, Sequence[str]]
    ) -> None:
        self._tree = tree
        self._publishers = publishers
        self._heard = {topic: tree.publishers(is_static=topic == TF_STATIC) for topic in (TF, TF_STATIC)}
        self._nodes = {
            topic: _concluded(
                tree.writers(is_static=topic == TF_STATIC),
                _there(tree, topic, publishers.get(topic, Publishers())),
                _all(publishers.get(topic)),
                tree,
                also,
                is_static=topic == TF_STATIC,
            )
            for topic in (TF, TF_STATIC)
        }

    def of(self, edge: Edge) -> str:
        """Return the edge's publisher: its name; `probably …` if inferred; `one of …` if not known; empty if there is
        none.
        """
        if edge.is_left and edge.is_static and not self._publishers.get(TF_STATIC, Publishers()).gone:
            return f"a node that was not seen{GONE}"
        return self._named(TF_STATIC if edge.on_static else TF, edge.writers)

    def on(self, topic: str, edge: Edge, parent: str) -> str:
        """Return the nodes that publish the edge with that parent on /tf or /tf_static, worded as by `of`."""
        writers = edge.static_writers_of(parent) if topic == TF_STATIC else edge.writers_of(parent)
        return self._named(topic, writers)

    def by_whom(self, edge: Edge, parent: str) -> str:
        """Return " by …" with the publisher of the edge with that parent, to follow a name; empty if it is not
        known.
        """
        is_moving = any(one.parent == parent for one in edge.moving)
        topic = TF_STATIC if not is_moving and (parent in edge.static or edge.on_static) else TF
        who = self._named(topic, edge.writers_of(parent))
        return f" by {who}" if who else ""

    def silent(self, topic: str) -> tuple[int, Sequence[str]]:
        """Return how many publishers of a topic have sent nothing, and the nodes that they are or may be."""
        publishers, nodes = self._publishers.get(topic, Publishers()), self._nodes[topic]
        count = len(_all(publishers)) - min(len(nodes), self._heard[topic])
        if count <= 0:
            return 0, ()
        heard = set[str]().union(*nodes.values())
        sure = set[str]().union(*(names for names in nodes.values() if len(names) == 1))
        now = publishers.now
        return count, next(filter(None, ([name for name in now if name not in known] for known in (heard, sure))), now)

    @property
    def is_silent(self) -> bool:
        """Whether a publisher from which a message is expected has not sent any yet."""
        return any(
            count and not self.waits_for_joints(topic, names)
            for topic in (TF, TF_STATIC)
            for count, names in [self.silent(topic)]
        )

    @property
    def has_localisation(self) -> bool:
        """Whether odom, or a moving frame, has a transform from a map frame."""
        told = [(edge, edge.newest) for edge in self._tree.edges.values()]
        return any(
            edge.child.rpartition("/")[2] == "odom" or (edge.moving and newest.parent.rpartition("/")[2] == "map")
            for edge, newest in told
            if newest
        )

    def is_missed(self, names: Sequence[str]) -> bool:
        """Return whether a transform is missing that one of these silent nodes may have to publish.

        It is missing if the frames are not one tree; if a node is named like a localisation, and neither odom nor a
        moving frame has a map as its parent; or if a node is named like an odometry source, and the base has no parent.
        Silence alone proves nothing: a controller whose odometry transform is disabled still has a publisher on /tf.
        """
        tree, roles = self._tree, {_role_of_name(name) for name in names}
        if len(tree.roots) != 1 or (_LOCALISATION in roles and not self.has_localisation):
            return True
        return "odometry" in roles and tree.base in tree.roots

    def waits_for_joints(self, topic: str, names: Sequence[str]) -> bool:
        """Return whether these nodes are silent on /tf because nothing moves: they publish on /tf_static, as a state
        publisher with fixed joints only does.
        """
        static = self._publishers.get(TF_STATIC, Publishers())
        return topic == TF and set(names) <= set(static.now) and not self.silent(TF_STATIC)[0]

    def _named(self, topic: str, writers: Sequence[int]) -> str:
        names = _all(self._publishers.get(topic))
        if len(names) < 2:
            return self._with_fate(topic, names[0]) if names else ""
        nodes = self._nodes[topic]
        possible = [nodes[writer] for writer in writers if writer in nodes]
        found = sorted(set[str]().union(*possible)) or list(names)
        if possible and len(found) == len(possible):
            return f"probably {' and '.join(self._with_fate(topic, name) for name in found)}"
        more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
        return f"one of {', '.join(found[:_MOST_NAMED])}{more}"

    def _with_fate(self, topic: str, name: str) -> str:
        gone = name in self._publishers.get(topic, Publishers()).gone
        return f"{named(name)}{GONE}" if gone else named(name)


async def tellers_of(source: Source, tree: FrameTree) -> Tellers:
    """Return the publishers of a robot's edges; for a recording none are known."""
    if (listener := source.transforms) is None:
        return Tellers(tree, {}, {})
    publishers: dict[str, Publishers] = {}
    for topic in (TF, TF_STATIC):
        found = await listener.publishers(topic)
        now = sorted({one.who for one in found if one.type == TF_TYPE and not mismatch(one.qos, LISTENS[topic])})
        lives = listener.lives(topic)
        gone = sorted(name for name, life in lives.items() if life.gone_by_ns is not None and name not in now)
        publishers[topic] = Publishers(now, gone, lives)
    nodes = sorted({name for one in publishers.values() for name in _all(one)})
    if max(len(_all(one)) for one in publishers.values()) < 2:
        return Tellers(tree, publishers, {})
    return Tellers(tree, publishers, await listener.also_publish(nodes))


def silent_in_words(tellers: Tellers, since_s: float, *, harmless: bool | None = None) -> list[str]:
    """Report the publishers on /tf or /tf_static that sent nothing in `since_s` seconds. `harmless` selects those whose
    silence leaves no edge missing (True) or the others (False); None: all.
    """
    found: list[str] = []
    for topic in (TF, TF_STATIC):
        count, names = tellers.silent(topic)
        if not count or not names:
            continue
        has_reason = tellers.waits_for_joints(topic, names)
        is_missed = not has_reason and (topic == TF_STATIC or tellers.is_missed(names))
        if harmless is is_missed:
            continue
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        who = f"{', '.join(map(named, names[:_MOST_NAMED]))}{more}"
        many = f"{count} of {who}" if count < len(names) else who
        waits = ""
        if not tellers.has_localisation and any(_role_of_name(name) == _LOCALISATION for name in names):
            waits = " A localisation publishes nothing until it knows where the robot is."
        elif not is_missed and not has_reason:
            waits = " No edge is missing because of it: a controller may have its odometry transform switched off."
        verb = "publish" if len(names) > 1 and count == len(names) else "publishes"
        found.append(f"{many} {verb} on {topic} and has sent nothing in {since_s:.0f} s.{waits}")
    return found


def _all(publishers: Publishers | None) -> Sequence[str]:
    return [*publishers.now, *publishers.gone] if publishers else ()


# ── who it is ────────────────────────────────────────────────────────────────────────────────────────────────────────


def _there(tree: FrameTree, topic: str, publishers: Publishers) -> Mapping[int, set[str]]:
    """Return, for each publisher, the nodes present whenever it was received; all nodes if none fits."""
    found: dict[int, set[str]] = {}
    for writer, (first_ns, last_ns) in tree.heard_ns(is_static=topic == TF_STATIC).items():
        there = {
            name
            for name in _all(publishers)
            if (life := publishers.lives.get(name, Life())).not_before_ns <= first_ns + _SEEN_LATE_NS
            and (life.gone_by_ns is None or last_ns <= life.gone_by_ns + _HEARD_LATE_NS)
        }
        found[writer] = there or set(_all(publishers))
    if topic == TF_STATIC and any(edge.is_left for edge in tree.edges.values()):
        # Static transforms were received again after nodes had left: an edge without a publisher now belongs to a node
        # that left.
        for writer, children in tree.writers(is_static=True).items():
            is_left = any(tree.edges[child].is_left for child in children if child in tree.edges)
            found[writer] = found[writer] & set(publishers.gone if is_left else publishers.now) or found[writer]
    return found


def _concluded(
    writers: Mapping[int, frozenset[str]],
    there: Mapping[int, set[str]],
    names: Sequence[str],
    tree: FrameTree,
    also: Mapping[str, Sequence[str]],
    *,
    is_static: bool,
) -> Mapping[int, set[str]]:
    """Return the nodes that each publisher may be, among those `there` when it was received.

    If as many publishers as nodes fit each other by one kind of evidence, they are identified, and these nodes are
    excluded for other publishers. The evidence is first what else the nodes publish, then their names.
    """
    possible = {writer: set(there.get(writer, names)) for writer in writers if writer}
    roles = {writer: _roles(tree, writer, writers[writer], is_static=is_static) for writer in possible}
    fitting = [
        {writer: {name for role in roles[writer] for name in also.get(_AS.get(role, role), ())} for writer in possible},
        {writer: {name for name in names if roles[writer] & _roles_of_name(name)} for writer in possible},
    ]
    for fits in fitting:
        groups: dict[frozenset[str], list[int]] = {}
        for writer, nodes in fits.items():
            left = nodes & possible[writer]
            if left and len(possible[writer]) > 1:
                groups.setdefault(frozenset(left), []).append(writer)
        for nodes, group in groups.items():
            if len(nodes) == len(group):
                _are(possible, group, nodes)
    if len(possible) == len(names):
        for _ in names:  # elimination: each identified node is excluded for the other publishers
            for writer, nodes in possible.items():
                if len(nodes) == 1:
                    _are(possible, [writer], frozenset(nodes))
    return possible


def _are(possible: dict[int, set[str]], writers: Sequence[int], nodes: frozenset[str]) -> None:
    for writer, others in possible.items():
        if writer in writers:
            possible[writer] = others & nodes or others
        elif len(others - nodes):
            possible[writer] = others - nodes


def _roles(tree: FrameTree, writer: int, children: Iterable[str], *, is_static: bool) -> set[str]:
    """Return the roles that a publisher of these edges may have; empty if one of the edges fits no known role."""
    edges = [tree.edges[child] for child in children if child in tree.edges]
    roles = {_static_role(edge, writer) if is_static else _role(edge, writer) for edge in edges}
    return set() if "" in roles else roles


def _static_role(edge: Edge, writer: int) -> str:
    """Return "description" for a mount, else empty: no description publishes the robot's pose, or a base below another
    link.
    """
    child, parent = edge.child.rpartition("/")[2], edge.static_parent_by(writer).rpartition("/")[2]
    is_place = parent in ("map", "odom") or child == "odom"
    return "" if is_place or (child in BASES and parent not in (*BASES, "world")) else "description"


def _role(edge: Edge, writer: int) -> str:
    """Return the role of an edge's publisher, by the frame names of REP 105."""
    child, parent = edge.child.rpartition("/")[2], edge.parent_by(writer).rpartition("/")[2]
    if child == "odom":
        return _LOCALISATION
    if parent == "map":
        return "placing"
    return "odometry" if child in BASES or parent == "odom" else "description"


def _role_of_name(name: str) -> str:
    last = name.rpartition("/")[2].lower()
    return next((role for role, pattern in reversed(_CALLED.items()) if pattern.search(last)), "")


def _roles_of_name(name: str) -> set[str]:
    role = _role_of_name(name)
    return {role, "placing"} if role == _LOCALISATION and not _CORRECTS.search(name.rpartition("/")[2]) else {role}
