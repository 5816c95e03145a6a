"""The policy in force, told to the agent; and a draft of one, made from the live graph."""
