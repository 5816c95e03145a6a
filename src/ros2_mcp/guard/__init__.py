"""May I, and how fast? Decides, never acts."""
