"""Simulated robots made of ordinary ROS 2 nodes: `python -m ros2_mcp_demo --robot rover`.

`robots` has them by name. A robot is a folder with what it is and does without ROS, its nodes, and the module that
puts them together; the rover, the first one, has this folder itself and `nodes`. What all have in common is in `robot`
(start, loop, end), `nodes/part` (a node), `nodes/health` (diagnostics) and `optional` (packages that may be missing).

The rover: a round base (radius 0.2 m) starts at (0, 0) in the map, looking along x, in a room from (-2, -3) to
(6, 3) m. A wall at x = 2.5 divides the room; its doorway spans y from 0.8 to 1.8. A red pillar stands at (1.6, -1.0), a
yellow box at (-1.2, 2.0); in the other half a blue box at (4.2, -0.9) and a green pillar at (4.6, 1.7).
Its `world`, `base`, `battery`, `picture`, `planner`, `drive` and `simulation` know no ROS; `nodes` has one module for
each ROS node; `rover` puts them together.
"""
