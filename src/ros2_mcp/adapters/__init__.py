"""What belongs to one vendor: a file for each format or system of theirs that can be used as it is."""
