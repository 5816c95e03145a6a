"""Motion by feedback: drives, motions until a condition holds, goals cancelled on a condition,
and the watchdog's topics.
"""
