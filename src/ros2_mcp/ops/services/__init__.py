"""Services: which there are, and calling them."""
