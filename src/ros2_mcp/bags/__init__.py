"""Recordings as bytes: writing and reading MCAP and rosbag2 folders. Knows topics, types and times, no values."""
