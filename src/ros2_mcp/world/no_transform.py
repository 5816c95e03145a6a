"""Explain why there is no transform between two frames, from the transforms received."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from ros2_mcp.model.errors import NoTransform
from ros2_mcp.model.names import may_be_one, nearest
from ros2_mcp.model.text import counted, listed, named
from ros2_mcp.model.times import recorded_time
from ros2_mcp.world.frame_edges import Edge
from ros2_mcp.world.transforms import BASES, FrameTree, Located

_MOST_NAMED = 8
"""Frames in a sentence."""
_DAY_S = 86_400
_YEAR_S = 365.25 * _DAY_S
UNIX_FROM_NS = 10**18
"""A stamp before 2001 comes from another clock, such as that of a simulation, and is shown in seconds."""


def stamp_in_words(stamp_ns: int, began_ns: int | None = None) -> str:
    """Format a stamp as a time, in a recording with the seconds since its start.

    A stamp that is no calendar time is given in seconds.
    """
    return recorded_time(stamp_ns, began_ns) if stamp_ns >= UNIX_FROM_NS else f"{stamp_ns / 1e9:.3f} s of its clock"


def seconds_in_words(away_ns: int) -> str:
    """Return a duration in a readable unit: ms, s, days or years."""
    away_s = abs(away_ns) / 1e9
    if away_s >= _YEAR_S:
        return f"{away_s / _YEAR_S:.1f} years"
    if away_s >= 2 * _DAY_S:
        return f"{away_s / _DAY_S:.1f} days"
    return f"{away_s * 1000:.3g} ms" if away_s < 0.1 else f"{away_s:.3g} s" if away_s < 1000 else f"{away_s:.0f} s"


def located(tree: FrameTree, target: str, frame: str, at_ns: int | None = None) -> Located:
    """Return the pose of a frame in the target at a time, or (None) at the newest time that all edges have.

    Raises:
        NoTransform: if there is none, with the reason.
    """
    target, frame = target.lstrip("/"), frame.lstrip("/")
    found = tree.find(target, frame, at_ns)
    if found is None:
        raise why_none(tree, target, frame, at_ns)
    return found


def why_none(tree: FrameTree, target: str, frame: str, at_ns: int | None) -> NoTransform:
    """Return the error for a lookup that found no transform, or none that can be trusted."""
    for name in (frame, target):
        if name not in tree.frames:
            return _unknown(tree, name)
    up = [*tree.way_up(frame), *tree.way_up(target)]
    edges = tree.connected(target, frame)
    for edge in up if edges is None else edges:
        if edge.two_parents:
            circle = tree.circle_by(edge.child)
            return _circle(tree, circle) if circle else _two_parents(edge)
    for edge in up:
        if circle := tree.circle_of(edge.child):
            return _circle(tree, circle)
    if edges is not None and (circle := tree.hidden_circle(target, frame, edges)):
        return _circle(tree, circle)
    if edges is None:
        roots = {tree.root_of(target), tree.root_of(frame)}
        for edge in tree.edges.values():
            if edge.two_parents and roots <= {tree.root_of(parent) for parent in edge.parents}:
                return _two_parents(edge)
        return _two_trees(tree, target, frame)
    sought_ns = tree.common_ns(target, frame) if at_ns is None else at_ns
    lacking = [edge for edge in edges if edge.moving and sought_ns is not None and edge.at(sought_ns) is None]
    if not lacking or sought_ns is None:
        return NoTransform("not connected", f"{named(frame)} and {named(target)} were not connected at that time.")
    if at_ns is None:
        return _no_common_time(tree, edges, lacking, sought_ns)
    return _not_then(tree, lacking, sought_ns)


def _unknown(tree: FrameTree, name: str) -> NoTransform:
    if not tree.frames:
        heard = sum(tree.messages.values())
        said = (
            f"{counted(heard, 'message')} came without a transform." if heard else "Nothing came on /tf or /tf_static."
        )
        return NoTransform("never published", f"No transform has been received. {said}")
    near = nearest(name, list(tree.frames))
    blank = " (published with a space before or after its name)" if near != near.strip() else ""
    hint = f"Did you mean {named(near)}{blank}? " if near else ""
    known = listed(sorted(tree.frames), _MOST_NAMED)
    message = f"There is no frame {named(name)} in TF."
    return NoTransform("unknown frame", message, f"{hint}Known frames: {known}.")


def _two_parents(edge: Edge) -> NoTransform:
    parts = [f"{named(parent)} ({_how_told(edge, parent)})" for parent in edge.parents]
    message = f"{named(edge.child)} has {len(parts)} parents at the same time: {' and '.join(parts)}."
    hint = "End one of the publishers: a frame has one parent, and tf2 jumps between two."
    return NoTransform("two parents", message, hint)


def _how_told(edge: Edge, parent: str) -> str:
    of_it = [told for told in edge.moving if told.parent == parent]
    if not of_it:
        return "static"
    span_ns = of_it[-1].stamp_ns - of_it[0].stamp_ns
    return f"{(len(of_it) - 1) / span_ns * 1e9:.3g} Hz" if len(of_it) > 1 and span_ns > 0 else "published once"


def _circle(tree: FrameTree, frames: Sequence[str]) -> NoTransform:
    reverse = ", each edge the reverse of the other" if len(frames) == 2 else ""
    message = f"The frames form a loop: {circle_in_words(frames)}{reverse}."
    for child, parent in zip(frames, [*frames[1:], frames[0]], strict=True):
        edge = tree.edges[child]
        if others := [f"{named(one)} ({_how_told(edge, one)})" for one in edge.parents if one != parent]:
            message += f" {named(child)} is in {' and '.join(others)}, too, which is not part of the loop."
    hint = "Remove or reverse one of these edges; static_transform_publisher takes the parent first."
    return NoTransform("circle", message, hint)


def circle_in_words(frames: Sequence[str], by: Callable[[str, str], str] = lambda _child, _parent: "") -> str:
    """Describe a loop of frames, each with its parent; `by` adds the publisher for a child and its parent."""
    steps = zip(frames, [*frames[1:], frames[0]], strict=True)
    return ", ".join(f"{named(child)} is in {named(parent)}{by(child, parent)}" for child, parent in steps)


def _two_trees(tree: FrameTree, target: str, frame: str) -> NoTransform:
    parts: list[str] = []
    for name in (frame, target):
        root = tree.root_of(name)
        others = sorted(other for other in tree.frames if other != root and tree.root_of(other) == root)
        with_others = f", with {listed(others, _MOST_NAMED)}" if others else ", alone"
        parts.append(
            f"{named(name)} is in the tree of {named(root)}{with_others}"
            if name != root
            else f"{named(name)} is the root of a tree{with_others}"
        )
    refused = [edge for edge in (tree.edges.get(tree.root_of(frame)), tree.edges.get(tree.root_of(target))) if edge]
    why = " ".join(
        f"What is published of {f'{named(edge.refused_parent)} → ' if edge.refused_parent else ''}{named(edge.child)} "
        f"is refused: {edge.refused}."
        for edge in refused
        if edge.refused
    )
    message = f"Two trees with no transform between them: {'; '.join(parts)}."
    hint = "" if why else _misspelt(tree, target, frame) or _missing_edge(tree, target, frame)
    return NoTransform("not valid" if why else "two trees", f"{message} {why}".rstrip(), hint)


def alike(tree: FrameTree, target: str, frame: str) -> tuple[str, str] | None:
    """Return two frames of different trees whose names suggest that they are the same frame; one of the two is the root
    of its tree.
    """
    roots = {name: tree.root_of(name) for name in tree.frames}
    for root in dict.fromkeys((roots[frame], roots[target])):
        others = [name for name, top in roots.items() if top != root and may_be_one(root, name)]
        if others:
            return root, nearest(root, others) or others[0]
    return None


def _misspelt(tree: FrameTree, target: str, frame: str) -> str:
    pair = alike(tree, target, frame)
    if pair is None:
        return ""
    one, other = map(named, pair)
    if ("/" in pair[0]) != ("/" in pair[1]):
        return f"{one} and {other} differ by a prefix alone: are they meant to be one frame?"
    return f"{one} and {other} are nearly the same name: is one of them misspelt?"


def _missing_edge(tree: FrameTree, target: str, frame: str) -> str:
    """Return a hint which edge is missing, if names by REP 105 show which node should publish it."""
    roots = {tree.root_of(target), tree.root_of(frame)}
    base = next((root for root in sorted(roots) if root.rpartition("/")[2] in BASES), "")
    odom = next((name for name in sorted(tree.frames) if name.rpartition("/")[2] == "odom"), "")
    below = {tree.root_of(name) for name in tree.frames if name.rpartition("/")[2] in BASES}
    if base and odom and tree.root_of(odom) in roots - below:  # else odom has a base, and another edge is missing
        edge = f"{named(odom)} → {named(base)}"
        return f"Start the base's controller or the state estimation: {edge} has no publisher."
    last = {root.rpartition("/")[2]: root for root in roots}
    if "map" in last and "odom" in last:
        edge = f"{named(last['map'])} → {named(last['odom'])}"
        return f"Start localisation (amcl, slam_toolbox): {edge} has no publisher."
    one, other = sorted(roots)
    return f"Publish a transform between {named(one)} and {named(other)}."


def _no_common_time(tree: FrameTree, edges: Iterable[Edge], lacking: Sequence[Edge], common_ns: int) -> NoTransform:
    """Explain that edges have no time in common: an edge has ended, or is stamped by another clock."""
    moving = [edge for edge in edges if edge.moving]
    oldest = min(moving, key=lambda edge: edge.stamps[-1])
    newest = max(moving, key=lambda edge: edge.stamps[-1])
    behind_ns = newest.stamps[-1] - oldest.stamps[-1]
    silent_ns = newest.last_received_ns - oldest.last_received_ns
    ends = f"{edge_in_words(oldest)} ends {seconds_in_words(behind_ns)} before {edge_in_words(newest)}"
    if abs(behind_ns - silent_ns) > max(_CLOCKS_NS, silent_ns // 2):
        jumped = [f"the stamps of {edge_in_words(edge)} {_jump_of(edge)}" for edge in (oldest, newest) if edge.jumps]
        reason = "clock jump" if jumped else "two clocks"
        told = [_clock_of(edge, tree) for edge in (oldest, newest)]
        clocks = f"they are stamped by different clocks: {', '.join(told)}"
        message = f"No time in common: by its stamps {ends}, although both came within {seconds_in_words(silent_ns)}"
        hint = "Set use_sim_time alike on all nodes, and synchronise the clocks of all computers."
        if not jumped and is_since_boot(tree, oldest):
            hint = (
                "Synchronise the clock of the machine whose stamps count from its start (NTP; micro-ROS: session time)."
            )
        if not jumped and all(edge.stamps[-1] >= UNIX_FROM_NS for edge in (oldest, newest)):
            hint = "Synchronise the clocks of all computers (chrony, NTP), or correct the publisher's stamps."
        return NoTransform(reason, f"{message}: {' and '.join(jumped) or clocks}.", hint)
    if silent_ns > _STALE_NS:
        message = f"Stale: {ends} ({stamp_in_words(common_ns)}), and was not published since."
        return NoTransform(
            "stale", message, "Restart its publisher, which has ended or hangs; ros2_topic_stats measures /tf."
        )
    begins = lacking[0]
    message = (
        f"{edge_in_words(begins)} begins {seconds_in_words(begins.stamps[0] - common_ns)} after that: nothing yet."
    )
    return NoTransform("not at that time", f"No time in common: {ends}, and {message}", "Ask again.")


def _jump_of(edge: Edge) -> str:
    jump = edge.jumps[-1]
    back = "back" if jump.to_ns < jump.from_ns else "forward"
    ago = seconds_in_words(edge.last_received_ns - jump.received_ns)
    return f"jumped {back} by {seconds_in_words(jump.to_ns - jump.from_ns)}, {ago} before the last of it"


def is_since_boot(tree: FrameTree, edge: Edge) -> bool:
    """Return whether stamps are near 1970 without simulated time: the clock of the machine was never set."""
    return tree.has_clock is False and not tree.clock_ns and edge.stamps[-1] < UNIX_FROM_NS


def _clock_of(edge: Edge, tree: FrameTree) -> str:
    """Name the clock by which an edge is stamped, from the difference between stamps and times of receipt."""
    ahead_ns, clock_ns = edge.stamps[-1] - edge.last_received_ns, tree.clock_ns
    if abs(ahead_ns) <= _CLOCKS_NS:
        return f"{edge_in_words(edge)} by the robot's (wall time)"
    if is_since_boot(tree, edge):
        boot = f"{stamp_in_words(edge.stamps[-1])}, in 1970, and /clock has no publisher"
        return f"{edge_in_words(edge)} by the time since its machine started, which is not synchronised ({boot})"
    if edge.stamps[-1] < UNIX_FROM_NS:
        off_ns = ahead_ns + clock_ns if clock_ns else 0
        off = f", {seconds_in_words(off_ns)} {'ahead of' if off_ns > 0 else 'behind'} the others"
        return f"{edge_in_words(edge)} by simulated time{off if abs(off_ns) > _CLOCKS_NS else ''}"
    away = f"{seconds_in_words(ahead_ns)} {'in the future' if ahead_ns > 0 else 'in the past'}"
    return f"{edge_in_words(edge)} {away} (another computer's clock?)"


_CLOCKS_NS = 2_500_000_000
"""Difference of stamp and receipt: localisations stamp up to 1 s ahead on purpose, and no usual delay is as long."""
_SLOW_NS = 1_500_000_000
"""Interval between two transforms; the slowest usual publishers send once a second."""
_STALE_NS = 1_000_000_000
"""Time without a message of a moving edge; the slowest usual publishers send once a second."""


def _not_then(tree: FrameTree, lacking: Sequence[Edge], sought_ns: int) -> NoTransform:
    edge = max(lacking, key=lambda one: min(abs(one.stamps[0] - sought_ns), abs(one.stamps[-1] - sought_ns)))
    first_ns, last_ns = edge.stamps[0], edge.stamps[-1]
    is_later = sought_ns > last_ns
    nearest_ns = last_ns if is_later else first_ns
    away = seconds_in_words(sought_ns - nearest_ns)
    message = (
        f"Nothing of {edge_in_words(edge)} at {stamp_in_words(sought_ns)}: the nearest is {away} "
        f"{'earlier' if is_later else 'later'}, at {stamp_in_words(nearest_ns)}."
    )
    ahead_ns = tree.clock_ns - edge.lag_ns
    if abs(ahead_ns) > _CLOCKS_NS:
        side = "ahead of" if ahead_ns > 0 else "behind"
        message += f" Its stamps are {seconds_in_words(ahead_ns)} {side} the time when it came."
    if len(edge.stamps) > 1:
        message += f" Stored transforms cover {stamp_in_words(first_ns)} to {stamp_in_words(last_ns)}."
        period_ns = (last_ns - first_ns) // (len(edge.stamps) - 1)
        if period_ns > _SLOW_NS:
            message += f" It is published only every {seconds_in_words(period_ns)}."
    if edge.jumps:
        jump = edge.jumps[-1]
        back = "back" if jump.to_ns < jump.from_ns else "forward"
        told = f" Its stamps jumped {back} by {seconds_in_words(jump.to_ns - jump.from_ns)}; earlier ones are not used."
        return NoTransform("clock jump", message + told, "A bag or simulation restarted, or a clock was set.")
    older = "Read older transforms from a recording (bag); a server with --black-box always keeps one."
    if tree.is_recorded:
        older = "Give a later time: this one is before the part of the recording that was read."
    hint = "Leave time out for the latest." if is_later else older
    return NoTransform("not at that time", message, hint)


def edge_in_words(edge: Edge) -> str:
    """Return an edge as `parent → child`."""
    return f"{named(edge.newest.parent) if edge.newest else '?'} → {named(edge.child)}"
