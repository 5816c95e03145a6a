"""The page for the human beside the agent: its views, the file that it is, and the local server that shows it."""
