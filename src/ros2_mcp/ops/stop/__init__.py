"""Whether the robot is observed to stand after a stop.

`judge.py` decides by the messages alone: which of them were published after the stop, and whether they show motion.
`observe.py` finds the topics that report motion and listens to them.
"""
