"""Actions: which there are, their goals, and what becomes of them."""
