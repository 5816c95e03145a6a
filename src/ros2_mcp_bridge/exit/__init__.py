"""The exits of the bridge: limits, ramps, watchdogs' stops and fail-safes for all messages
and requests that leave it.
"""
