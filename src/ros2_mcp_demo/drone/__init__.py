"""The drone: a quadcopter in the wind, with an autopilot behind MAVROS's topics and services. See `robot`.

`airframe`, `control`, `autopilot`, `mission`, `description` and `simulation` know no ROS; `body` and `mavros` are
nodes.
"""
