"""Where things are: frames and transforms."""
