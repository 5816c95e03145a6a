"""The past: recordings, bags, playbacks, and stored messages."""
