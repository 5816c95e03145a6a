"""The past: recordings, bags, playbacks, and messages that were kept."""
