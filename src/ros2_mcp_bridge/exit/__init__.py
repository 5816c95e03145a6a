"""The last check before the graph: velocities and trajectories, limits, watchdogs and fail-safes."""
