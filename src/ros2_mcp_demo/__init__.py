"""Simulated robots made of ordinary ROS 2 nodes: `python -m ros2_mcp_demo --robot rover`.

`robots` lists them by name. A robot is a folder with its simulation (without ROS), its nodes, and the module that puts
them together; the rover, the first robot, uses this folder and `nodes`. Shared by all: `robot` (start, loop, end),
`nodes/part` (the base class of nodes), `nodes/health` (diagnostics), `optional` (packages that may be missing).

The rover: a round base (radius 0.2 m) starts at (0, 0) in the map, facing along x, in a room from (-2, -3) to (6, 3) m.
A wall at x = 2.5 divides the room; its doorway spans y from 0.8 to 1.8. A red pillar stands at (1.6, -1.0), a yellow
box at (-1.2, 2.0); in the other half a blue box at (4.2, -0.9) and a green pillar at (4.6, 1.7). Its `world`, `base`,
`battery`, `picture`, `planner`, `drive` and `simulation` do not use ROS; `nodes` has one module for each ROS node;
`rover` puts them together.
"""
