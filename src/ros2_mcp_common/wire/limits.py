"""The limits that users and both sides of the stream rely on, each stated once. The server imports them from here.

Those of commands are kept by the bridge, too: a limit that only the server knows does not hold for what the server did
not look at.
"""

from __future__ import annotations

# Of repeats and relays. Chosen: no loop that drives a robot over a topic is faster.
MAX_RATE_HZ = 1000
# Of the same. Chosen: a message in 100 s; what is more rare than that is a publication each time, not a rate.
MIN_RATE_HZ = 0.01
# Of what one call may ask for: repeating, listening, waiting. Chosen: what takes longer than an hour is a job, which
# outlives the call and can be looked at and stopped.
MAX_DURATION_S = 3600
# Of one kind (`failsafe_publish`, `failsafe_call`). Each of the former keeps a publisher in use, of which the pool
# holds as many, and at the end all of them have 0.6 s together to reach the robot.
MAX_FAILSAFES = 64
# Publishers, and clients of services, that are kept for the next request although nobody uses them.
MAX_POOLED = 64
# Of a packet. Chosen with much room: the largest headers are listings of the whole graph and texts of definitions.
MAX_HEADER_BYTES = 16 * 1024 * 1024
# Of a packet: a picture of 4096 x 4096 in 32-bit RGBA has 67 MB, a cloud of 5 million points of 32 bytes 160 MB. Both
# sides hold a body as a whole, so that this also bounds what a broken stream can make them collect.
MAX_BODY_BYTES = 256 * 1024 * 1024
# Of a message or request whose values have limits. Its fields are judged one by one where commands leave, in 0.5 s for
# so many bytes: longer would hold up a stop's answer. The second is of one list in it, of which each element is judged.
MAX_JUDGED_BYTES = 1024 * 1024
MAX_JUDGED_ELEMENTS = 20_000
# Of samples that share a packet. Replies are written between packets: a larger one would delay them, smaller ones cost
# a system call for every few samples. It is also what fits into a pipe of the local carrier.
BATCH_BYTES = 1024 * 1024
# Of samples of all subscriptions that wait for the stream. Each may have 64 MB of them where it is alone; 32 readers of
# a camera had 1.9 GB before. Chosen: 2 s of a camera at full HD, and little beside what a robot's computer has.
MOST_WAITING_BYTES = 96_000_000
# For samples that may wait for so long in the bridge, as lines of the log that people and models read, nobody waits: at
# rest they wait for longer (AT_REST_S there), so that the bridge may sleep. Chosen.
NO_HURRY_S = 0.1
# Of a piece, in which large packets and samples cross a slow link. Between two of them a small packet passes: 26 ms at
# 5 Mbit/s. Smaller ones cost a packet and an acknowledgement each.
PIECE_BYTES = 16 * 1024
# Of pieces that are under way and not acknowledged, at the beginning and at least: what may be ahead of a small packet
# in the link. 0.1 s at 5 Mbit/s; 128 KiB were measured to double the time of a request there, for no more pictures.
WINDOW_BYTES = 64 * 1024
# Of the same, where the link carries more in the time of a round trip. Chosen: 160 Mbit/s at 0.2 s, and little memory.
MOST_WINDOW_BYTES = 4 * 1024 * 1024
# Of `ros2_drive`'s turns that steer back to its course or square a line, in rad/s: within the limits of the profiles of
# policies, which are asked about it before the drive begins.
STEER_MOST = 0.4
