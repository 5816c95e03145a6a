"""What this server costs, against two floors: a trivial tool on the bare SDK, and bare rclpy. Run: `python -m bench`."""
