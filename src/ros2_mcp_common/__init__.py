"""The code that server and bridge share: stream, policies, languages. Standard library only, no ROS."""
