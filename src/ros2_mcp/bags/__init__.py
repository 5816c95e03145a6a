"""Read and write recordings (MCAP files, rosbag2 folders) as bytes: topics, types and times, but no field values."""
