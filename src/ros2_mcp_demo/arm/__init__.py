"""The arm: six joints and a gripper on a table, with two joint trajectory controllers. See `robot`."""
