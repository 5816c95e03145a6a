"""What server and bridge share: stream, policies, small languages. Standard library only, no ROS."""
