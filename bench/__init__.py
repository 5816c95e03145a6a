"""What this server costs beside two floors: a trivial tool on the bare SDK, and bare rclpy. Run `python -m bench`."""
