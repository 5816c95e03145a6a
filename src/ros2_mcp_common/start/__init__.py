"""How a bridge starts: the first stage that is sent, and finding an installation of ROS."""
