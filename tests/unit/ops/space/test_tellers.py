"""Which node tells which edge, concluded from what each node publishes besides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ros2_mcp.codec.transforms import FrameTree
from ros2_mcp.ops.space.tellers import Publishers, Tellers, silent_in_words
from ros2_mcp.robot.transforms import Life

SECOND = 1_000_000_000
ALSO = {"odometry": ["/base"], "localisation": ["/amcl"], "description": []}


def told(parent: str, child: str, stamp_ns: int) -> Any:
    header = SimpleNamespace(frame_id=parent, stamp=SimpleNamespace(sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND))
    transform = SimpleNamespace(
        translation=SimpleNamespace(x=0.0, y=0.0, z=0.0), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform)


def tree_of(*publishers: tuple[int, tuple[tuple[str, str], ...]]) -> FrameTree:
    """For each publisher the number of its first message, and the edges that it tells in each."""
    tree = FrameTree()
    for number in range(1, 20):
        stamp_ns = 1_700_000_000 * SECOND + number * SECOND // 10
        for first, edges in publishers:
            message = SimpleNamespace(transforms=[told(*edge, stamp_ns) for edge in edges])
            tree.add(message, stamp_ns, is_static=False, sequence=first + number)
    return tree


def test_the_only_publisher_tells_all_edges() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    assert Tellers(tree, {"/tf": Publishers(["/base"])}, {}).of(tree.edges["base_link"]) == "/base"


def test_who_publishes_odometry_tells_where_the_base_is_and_the_last_one_the_rest() -> None:
    tree = tree_of(
        (1, (("odom", "base_link"),)),
        (500, (("map", "odom"),)),
        (9000, (("base_link", "wheel"), ("base_link", "arm"))),
    )
    tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/base", "/state_publisher"])}, ALSO)
    assert {child: tellers.of(edge) for child, edge in tree.edges.items()} == {
        "base_link": "probably /base",
        "odom": "probably /amcl",
        "wheel": "probably /state_publisher",
        "arm": "probably /state_publisher",
    }


def test_where_it_is_not_clear_all_that_fit_are_named() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("a", "b"),)))
    assert Tellers(tree, {"/tf": Publishers(["/one", "/two"])}, ALSO).of(tree.edges["base_link"]) == "one of /one, /two"


def test_two_publishers_of_one_edge_are_named_and_innocent_ones_are_not() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("odom", "base_link"),)), (9000, (("map", "odom"),)))
    tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/base", "/ekf"])}, {"odometry": [], "localisation": []})
    assert tellers.of(tree.edges["base_link"]) == "probably /base and /ekf"
    assert tellers.of(tree.edges["odom"]) == "probably /amcl"


def test_each_of_two_parents_has_its_publishers() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("odom_combined", "base_link"),)), (9000, (("map", "odom"),)))
    tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/diff_drive", "/ekf"])}, {})
    assert tellers.by_whom(tree.edges["base_link"], "odom") == " by one of /diff_drive, /ekf"
    assert tellers.by_whom(tree.edges["odom"], "map") == " by probably /amcl"


def test_a_parent_of_tf_static_is_that_of_a_publisher_there() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    message = SimpleNamespace(transforms=[told("laser", "base_link", SECOND)])
    tree.add(message, 1_700_000_001 * SECOND, is_static=True, sequence=1)
    tellers = Tellers(tree, {"/tf": Publishers(["/ekf"]), "/tf_static": Publishers(["/laser_tf"])}, {})
    told_by = [tellers.by_whom(tree.edges["base_link"], parent) for parent in ("odom", "laser")]
    assert told_by == [" by /ekf", " by /laser_tf"]


def test_a_publisher_that_has_sent_nothing_is_named() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/diff_drive"])}, {})
    said = silent_in_words(tellers, 4.0)
    assert said[0].startswith("/amcl publishes on /tf and has sent nothing in 4 s of listening.")
    unclear = Tellers(tree, {"/tf": Publishers(["/one", "/two"])}, {})
    assert silent_in_words(unclear, 4.0)[0].startswith("1 of /one, /two publishes on /tf and has sent nothing")


def test_a_state_publisher_of_which_nothing_moves_is_told_but_is_no_fault() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    message = SimpleNamespace(transforms=[told("base_link", "laser", SECOND)])
    tree.add(message, 1_700_000_001 * SECOND, is_static=True, sequence=1)
    states = "/robot_state_publisher"
    publishers = {"/tf": Publishers(["/ekf", states]), "/tf_static": Publishers([states])}
    tellers = Tellers(tree, publishers, {})
    assert silent_in_words(tellers, 4.0, harmless=False) == []
    assert len(silent_in_words(tellers, 4.0, harmless=True)) == len(silent_in_words(tellers, 4.0)) == 1
    lost = Tellers(tree, {**publishers, "/tf": Publishers(["/ekf", "/amcl"])}, {})
    assert len(silent_in_words(lost, 4.0, harmless=False)) == 1 and silent_in_words(lost, 4.0, harmless=True) == []


def test_the_edge_of_a_node_that_is_gone_is_not_credited_to_another() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("map", "odom"),)))
    tellers = Tellers(tree, {"/tf": Publishers(["/diff_drive"], ["/amcl"])}, {})
    assert tellers.of(tree.edges["odom"]) == "probably /amcl, which is gone"
    assert tellers.of(tree.edges["base_link"]) == "probably /diff_drive"


def test_who_came_later_or_had_gone_before_is_no_suspect() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    first_s = 1_700_000_000
    came = {"/late": Life(not_before_ns=(first_s + 10) * SECOND)}
    tellers = Tellers(tree, {"/tf": Publishers(["/base", "/late"], lives=came)}, {})
    assert tellers.of(tree.edges["base_link"]) == "probably /base"
    went = {"/early": Life(gone_by_ns=(first_s - 10) * SECOND)}
    tellers = Tellers(tree, {"/tf": Publishers(["/base"], ["/early"], went)}, {})
    assert tellers.of(tree.edges["base_link"]) == "probably /base"
    at_that_time = {"/other": Life(not_before_ns=(first_s + 2) * SECOND)}  # as late as it may have been discovered
    unclear = Tellers(tree, {"/tf": Publishers(["/one", "/other"], lives=at_that_time)}, {})
    assert unclear.of(tree.edges["base_link"]) == "one of /one, /other"


def test_fixed_mounts_of_several_publishers_are_not_guessed() -> None:
    tree = FrameTree()
    for number, children in ((1, ("base_link", "camera_link")), (1, ("lidar_link",))):
        message = SimpleNamespace(transforms=[told("base_footprint", child, SECOND) for child in children])
        tree.add(message, SECOND, is_static=True, sequence=number)
    names = {"/tf_static": Publishers(["/lidar_driver", "/robot_state_publisher"])}
    tellers = Tellers(tree, names, {"description": ["/robot_state_publisher"]})
    assert {tellers.of(edge) for edge in tree.edges.values()} == {"one of /lidar_driver, /robot_state_publisher"}


def test_a_publisher_that_is_first_heard_with_the_next_number_of_another_is_told_from_it() -> None:
    tree = FrameTree()

    def tell(sequence: int, edge: tuple[str, str]) -> None:
        stamp_ns = 1_700_000_000 * SECOND + sequence * SECOND // 10
        message = SimpleNamespace(transforms=[told(*edge, stamp_ns)])
        tree.add(message, stamp_ns, is_static=False, sequence=sequence)

    tell(100, ("odom", "base_link"))
    for number in range(101, 120):
        tell(number, ("map", "odom"))
        tell(number, ("odom", "base_link"))
    assert len(tree.edges["odom"].writers) == len(tree.edges["base_link"].writers) == 1
    assert tree.edges["odom"].writers != tree.edges["base_link"].writers


def test_of_two_localisations_the_one_that_corrects_odometry_is_not_said_to_place_the_base() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("map", "odom"),)), (9000, (("map", "base_link"),)))
    for also in ({}, {"localisation": ["/amcl", "/slam_node"]}):
        tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/ekf_node", "/slam_node"])}, also)
        base = tree.edges["base_link"]
        assert tellers.by_whom(base, "map") == " by probably /slam_node"
        assert tellers.by_whom(base, "odom") == " by probably /ekf_node"
        assert tellers.by_whom(tree.edges["odom"], "map") == " by probably /amcl"


def test_a_publisher_that_is_silent_is_missed_also_after_two_others_took_each_others_edges_over() -> None:
    tree = FrameTree()
    base, wheel = ("odom", "base_link"), ("base_link", "wheel")
    moved = [(10, base), (12, wheel), (11, wheel), (13, base), (12, wheel), (14, base), (13, wheel), (15, base)]
    for place, (sequence, edge) in enumerate(moved):
        stamp_ns = 1_700_000_000 * SECOND + place * SECOND // 20
        message = SimpleNamespace(transforms=[told(*edge, stamp_ns)])
        tree.add(message, stamp_ns, is_static=False, sequence=sequence)
    tellers = Tellers(tree, {"/tf": Publishers(["/amcl", "/base", "/wheels"])}, {})
    assert tellers.silent("/tf")[0] == 1
    assert Tellers(tree, {"/tf": Publishers(["/base", "/wheels"])}, {}).silent("/tf") == (0, ())
