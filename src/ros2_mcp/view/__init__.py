"""The web page for the human: its views, the page file, and the local server that serves it."""
