"""The publishers of a topic are told apart by their numbers, also when others tell their frames from then on."""

import random

from ros2_mcp.values.writers import Writers


def test_two_publishers_that_take_over_each_others_frames_stay_two():
    writers = Writers()
    first = [writers.of(number, about) for number, about in ((10, {"base"}), (12, {"wheel"}))]
    moved = [(11, {"wheel"}), (13, {"base"}), (12, {"wheel"}), (14, {"base"}), (13, {"wheel"})]
    for number, about in moved:
        writers.of(number, about)
    assert writers.count == len(first) == 2


def test_a_publisher_of_latched_frames_that_takes_one_over_is_no_further_one():
    writers = Writers(by_frames=True)
    told = [(1, {"x", "y"}), (1, {"z"}), (2, {"x", "z"}), (2, {"y"})]
    assert [writers.of(number, about) for number, about in told] == [1, 2, 2, 1]


def test_a_message_that_is_lost_makes_no_publisher():
    writers = Writers()
    told = [(10, {"base"}), (12, {"wheel"}), (13, {"base"}), (13, {"wheel"}), (14, {"base"}), (14, {"wheel"})]
    assert [writers.of(number, about) for number, about in told] == [1, 2, 1, 2, 1, 2]
    assert writers.count == 2


def test_as_many_publishers_are_counted_as_there_are_however_their_frames_move():
    for seed in range(300):
        chance = random.Random(seed)
        numbers = [chance.randint(1, 30) for _ in range(3)]
        tellers = list(range(3))
        writers = Writers()
        for turn in range(200):
            if turn % 50 == 49:
                chance.shuffle(tellers)
            order = chance.sample(range(3), 3)
            for publisher in order:
                writers.of(numbers[publisher], {f"frame {tellers[publisher]}"})
                numbers[publisher] += 1
        assert writers.count == 3, seed
