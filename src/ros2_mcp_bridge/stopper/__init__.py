"""The stopper: a process that sends the zeros when its bridge has died or hangs."""
