"""Everything that uses rclpy: context, clock, interfaces, QoS, raw publishers and subscriptions, the graph."""
