"""Whether the robot is seen to stand, for whatever has stopped it.

`judge.py` decides by the messages alone: which of them were published after the stop, and whether they show motion.
`observe.py` finds the topics that report motion and listens to them.
"""
