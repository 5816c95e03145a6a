"""What the bridge asks of rclpy: context, clock, interfaces, QoS, raw publishers and subscriptions."""
