"""Topics: which there are, reading, measuring their flow, publishing."""
