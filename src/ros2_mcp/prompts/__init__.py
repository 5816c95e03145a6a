"""Ready prompts and the user's own."""
