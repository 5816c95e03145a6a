"""Stop the robot, and observe whether it is stationary afterwards.

`stop.py` carries out the stop. `judge.py` decides by the messages alone which of them were published after the stop,
and whether they show motion. `observe.py` finds the topics that report motion and subscribes to them.
"""
