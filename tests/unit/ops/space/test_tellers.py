"""Which node tells which edge, concluded from what each node publishes besides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ros2_mcp.ops.space.edges import edge_row, in_words
from ros2_mcp.ops.space.tellers import Publishers, Tellers, silent_in_words
from ros2_mcp.robot.transforms import Life
from ros2_mcp.world.transforms import FrameTree

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
    assert said[0].startswith("/amcl publishes on /tf and has sent nothing in 4 s.")
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


def fixed(tree: FrameTree, *edges: tuple[str, str], sequence: int = 1) -> None:
    """A message on /tf_static."""
    message = SimpleNamespace(transforms=[told(*edge, SECOND) for edge in edges])
    tree.add(message, 1_700_000_001 * SECOND, is_static=True, sequence=sequence)


def test_who_tells_an_edge_on_each_of_both_topics_is_known() -> None:
    tree = tree_of((1, (("map", "odom"),)), (500, (("odom", "base_link"),)))
    fixed(tree, ("base_link", "laser"), ("base_link", "imu"))
    fixed(tree, ("map", "odom"))
    publishers = {"/tf": Publishers(["/amcl", "/base"]), "/tf_static": Publishers(["/robot_state_publisher", "/zero"])}
    tellers, edge = Tellers(tree, publishers, ALSO), tree.edges["odom"]
    assert tellers.on("/tf", edge, "map") == "probably /amcl"
    assert tellers.on("/tf_static", edge, "map") == "probably /zero"
    row = edge_row(tree, edge, 1_700_000_002 * SECOND, tellers)
    said = "odom is published on /tf by probably /amcl and on /tf_static by probably /zero alike, in map both times"
    assert in_words(row).startswith(said) and "end one of the two" in row.problem


def test_how_far_two_nodes_are_apart_is_told_no_more_exactly_than_it_counts() -> None:
    tree = FrameTree()
    for number in range(20):
        for first, x, turned in ((1, 0.0, 0.0), (500, 0.41, 1e-8)):
            one = told("odom", "base_link", 1_700_000_000 * SECOND + number * SECOND // 10)
            one.transform.translation.x, one.transform.rotation.z = x, turned
            message = SimpleNamespace(transforms=[one])
            tree.add(message, 1_700_000_000 * SECOND + number * SECOND // 10, is_static=False, sequence=first + number)
    row = edge_row(tree, tree.edges["base_link"], 1_700_000_002 * SECOND)
    assert "their transforms are 0.41 m and 0° apart" in row.problem


def test_the_reverse_of_a_mount_is_named_with_who_tells_it() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    fixed(tree, ("base_link", "laser"), ("base_link", "imu"))
    fixed(tree, ("laser", "base_link"))
    names = {"/tf": Publishers(["/base"]), "/tf_static": Publishers(["/laser_tf", "/robot_state_publisher"])}
    row = edge_row(tree, tree.edges["base_link"], 1_700_000_002 * SECOND, Tellers(tree, names, ALSO))
    said = "base_link has two parents at the same time: laser by probably /laser_tf and odom by /base; laser closes "
    assert in_words(row).startswith(f"{said}a loop") and "is published on" not in row.problem


def test_a_silent_publisher_is_no_fault_of_a_tree_that_lacks_nothing() -> None:
    tree = tree_of((1, (("odom", "base_link"),)), (500, (("map", "odom"),)))
    names = Publishers(["/amcl", "/diff_drive_controller", "/ekf"])
    tellers = Tellers(tree, {"/tf": names}, {})
    assert silent_in_words(tellers, 4.0, harmless=False) == []
    (note,) = silent_in_words(tellers, 4.0, harmless=True)
    assert note.startswith("1 of /diff_drive_controller, /ekf publishes on /tf") and "localisation" not in note
    lost = tree_of((500, (("map", "odom"),)), (1, (("base_link", "wheel"),)))
    assert silent_in_words(Tellers(lost, {"/tf": names}, {}), 4.0, harmless=True) == []
    alone = tree_of((1, (("base_link", "wheel"),)))
    states = Publishers(["/diff_drive_controller", "/joint_states"])
    assert silent_in_words(Tellers(alone, {"/tf": states}, {}), 4.0, harmless=True) == [], "nobody tells odom → base"


def test_what_is_fixed_and_left_behind_is_of_a_node_that_went_and_the_rest_of_those_that_are_there() -> None:
    tree = FrameTree()
    fixed(tree, ("base_link", "camera"))
    fixed(tree, ("base_link", "laser"), ("base_link", "imu"))
    tree.edges["camera"].is_left = True
    tellers = Tellers(tree, {"/tf_static": Publishers(["/states"], ["/calibration"])}, {})
    assert tellers.of(tree.edges["camera"]) == "probably /calibration, which is gone"
    assert tellers.of(tree.edges["laser"]) == "probably /states"
    row = edge_row(tree, tree.edges["camera"], 1_700_000_002 * SECOND, tellers)
    assert "its publisher has left (probably /calibration, which is gone)" in row.problem
    assert "nodes that start from now on do not get this frame" in row.problem
    unseen = Tellers(tree, {"/tf_static": Publishers(["/states"])}, {})
    assert unseen.of(tree.edges["camera"]) == "a node that was not seen, which is gone"
    fixed(tree, ("base_link", "camera"), sequence=1)
    assert not tree.edges["camera"].is_left, "somebody has told it again"


def test_of_a_silent_edge_it_is_said_whether_its_node_is_there() -> None:
    tree = tree_of((1, (("odom", "base_link"),)))
    late_ns = 1_700_000_030 * SECOND
    here = Tellers(tree, {"/tf": Publishers(["/base"])}, {})
    row = edge_row(tree, tree.edges["base_link"], late_ns, here)
    assert "by /base, which is still in the graph but no longer publishes it" in row.problem
    gone = Tellers(tree, {"/tf": Publishers([], ["/base"])}, {})
    row = edge_row(tree, tree.edges["base_link"], late_ns, gone)
    assert "by /base, which is gone" in row.problem and "still" not in row.problem
