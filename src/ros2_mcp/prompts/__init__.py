"""The base prompts, and the user's own."""
