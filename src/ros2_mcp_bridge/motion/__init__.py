"""Motion by feedback: drive, nudges, motion until a condition holds."""
