"""The process that sends the zero when its bridge has died."""
