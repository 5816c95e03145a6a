"""The order in which the messages of a file were written: where their times go backwards, and which have no time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ros2_mcp.bags.stored import LEAST_BACK_NS, OddTimes


@dataclass(frozen=True, slots=True)
class Written:
    """The messages of one channel in a part of a file, in the order in which they were written.

    `untimed` of the `count` messages are at time 0. The times of the others begin with `first_ns` and end with
    `last_ns`; the smallest is `least_ns`. `backs` has an entry for each message that is older than the one before: its
    position (from 1), the time of the message before, and its own.
    """

    count: int
    untimed: int
    first_ns: int
    last_ns: int
    least_ns: int
    backs: Sequence[tuple[int, int, int]] = ()


def written(keys: Sequence[tuple[int, int]]) -> dict[int, Written]:
    """Group messages by channel. `keys` are the channel and time of each message, as written."""
    times = [at_ns for _, at_ns in keys]
    if times and times[0] > 0 and times == sorted(times):  # true of nearly all, and needs no Python loop
        counts = Counter(channel for channel, _ in keys)
        first, last = dict(reversed(keys)), dict(keys)
        return {
            channel: Written(count, 0, first[channel], last[channel], first[channel])
            for channel, count in counts.items()
        }
    by_channel: dict[int, list[int]] = {}
    for channel, at_ns in keys:
        by_channel.setdefault(channel, []).append(at_ns)
    return {channel: _of(found) for channel, found in by_channel.items()}


def _of(times: Sequence[int]) -> Written:
    timed = [(number, at_ns) for number, at_ns in enumerate(times, 1) if at_ns]
    backs = [(number, before, at_ns) for (_, before), (number, at_ns) in pairwise(timed) if is_back(before, at_ns)]
    ends = (timed[0][1], timed[-1][1], min(at_ns for _, at_ns in timed)) if timed else (0, 0, 0)
    return Written(len(times), len(times) - len(timed), *ends, backs)


def is_back(before_ns: int, at_ns: int) -> bool:
    """Return whether a message is older than the message before it by at least `LEAST_BACK_NS`."""
    return before_ns - at_ns >= LEAST_BACK_NS


def odd_times(parts: Iterable[Mapping[int, Written] | None], names: Mapping[int, str]) -> dict[str, OddTimes]:
    """Return irregular times by topic over all parts of a file in order; a part that has not been read is None."""
    seen: dict[str, int] = {}
    last: dict[str, int] = {}
    untimed: Counter[str] = Counter()
    backs: dict[str, list[tuple[int, int, int]]] = {}  # position (0: not known), the time before, its own time
    is_whole = True
    for part in parts:
        if part is None:
            is_whole = False
            last.clear()
            continue
        for channel, found in part.items():
            name = names.get(channel)
            if name is None:
                continue
            before = seen.get(name, 0)
            untimed[name] += found.untimed
            steps = list(found.backs)
            if found.first_ns and name in last and is_back(last[name], found.first_ns):
                steps.insert(0, (1, last[name], found.first_ns))
            numbered = [(before + number if is_whole else 0, since_ns, at_ns) for number, since_ns, at_ns in steps]
            backs.setdefault(name, []).extend(numbered)
            seen[name] = before + found.count
            last[name] = found.last_ns or last.get(name, 0)
    odd: dict[str, OddTimes] = {}
    for name in seen:
        number, before_ns, at_ns = backs[name][0] if backs[name] else (0, 0, 0)
        if untimed[name] or backs[name]:
            odd[name] = OddTimes(untimed[name], len(backs[name]), number, at_ns, before_ns - at_ns)
    return odd
