"""Measures the cost of this server beside two floors: a trivial tool on the bare SDK, and bare rclpy. Run `python -m
bench`."""
