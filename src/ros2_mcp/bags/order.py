"""In which order the messages of a file were written: where their times go back, and which have none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ros2_mcp.bags.stored import LEAST_BACK_NS, OddTimes


@dataclass(frozen=True, slots=True)
class Written:
    """The messages of one channel in a part of a file, in the order in which they were written.

    `count` of them, of which `untimed` are at time 0; the others begin at `first_ns` and end at `last_ns`, and the
    oldest is at `least_ns`. `backs` are the numbers (from 1) of those that are older than the one before, with the time
    before and their own.
    """

    count: int
    untimed: int
    first_ns: int
    last_ns: int
    least_ns: int
    backs: Sequence[tuple[int, int, int]] = ()


def written(keys: Sequence[tuple[int, int]]) -> dict[int, Written]:
    """By channel; `keys` are channel and time of each message, in their order."""
    times = [at_ns for _, at_ns in keys]
    if times and times[0] > 0 and times == sorted(times):  # as nearly all are: without a step of Python for each
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
    """Whether a message is so much older than the one before that it means something."""
    return before_ns - at_ns >= LEAST_BACK_NS


def odd_times(parts: Iterable[Mapping[int, Written] | None], names: Mapping[int, str]) -> dict[str, OddTimes]:
    """What is odd in all parts of a file in their order, None for those that have not been read; by topic."""
    seen: dict[str, int] = {}
    last: dict[str, int] = {}
    untimed: Counter[str] = Counter()
    backs: dict[str, list[tuple[int, int, int]]] = {}  # number (0: not known), the time before, its own
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
