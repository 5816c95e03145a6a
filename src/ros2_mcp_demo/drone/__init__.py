"""The drone: a quadcopter in the wind, with an autopilot behind MAVROS's topics and services. See `robot`.

`airframe`, `control`, `autopilot`, `mission`, `description` and `simulation` do not use ROS; `body` and `mavros` are
nodes.
"""
