"""The limits that users and both sides of the stream rely on, each stated once. The server imports them from here.

The bridge enforces the limits of commands, too: a limit that only the server enforces does not hold for what it missed.
"""

from __future__ import annotations

# The highest rate of repeats and relays in Hz. No loop that drives a robot over a topic is faster.
MAX_RATE_HZ = 1000
# Their lowest rate: one message in 100 s. Anything slower is a single publication each time.
MIN_RATE_HZ = 0.01
# The longest duration in s that one call may request: repeating, listening, waiting. What takes longer than an hour is
# a job, which outlives the call and can be inspected and stopped.
MAX_DURATION_S = 3600
# The most fail-safes of one kind (`failsafe_publish`, `failsafe_call`). Each of the former keeps a publisher in use, of
# which the pool holds as many, and when the server is gone all of them have 0.6 s together to reach the robot.
MAX_FAILSAFES = 64
# The most unused publishers, and clients of services, that are kept for the next request.
MAX_POOLED = 64
# The largest header of a packet. The largest headers are listings of the whole graph and texts of definitions; this is
# far above them.
MAX_HEADER_BYTES = 16 * 1024 * 1024
# The largest body of a packet: an image of 4096 x 4096 in 32-bit RGBA has 67 MB, a cloud of 5 million points of 32
# bytes 160 MB. Both sides hold a body as a whole, so this also bounds the memory that a broken stream can use.
MAX_BODY_BYTES = 256 * 1024 * 1024
# The largest message or request whose values have limits. Its fields are judged one by one where commands leave, which
# takes 0.5 s for so many bytes; longer would delay the answer to a stop. The second limit is on the elements of one
# list, each of which is judged.
MAX_JUDGED_BYTES = 1024 * 1024
MAX_JUDGED_ELEMENTS = 20_000
# The most bytes of samples in one packet. Replies are written between packets: a larger packet would delay them,
# smaller ones cost a system call for every few samples. It also fits into a pipe of the local carrier.
BATCH_BYTES = 1024 * 1024
# The most bytes of samples, of all subscriptions together, that wait for the stream. A single one may use 64 MB of it;
# with 32 readers of a camera, 1.9 GB waited before there was this limit. It is 2 s of a full HD camera, and little
# compared with the memory of a robot's computer.
MOST_WAITING_BYTES = 96_000_000
# The longest wait in s of samples that are not urgent, such as lines of the log for people and models. At rest they
# wait longer (AT_REST_S of the loop), so that the bridge may sleep.
NO_HURRY_S = 0.1
# The largest piece of a large packet over a network. A small packet passes between two pieces: 26 ms at 5 Mbit/s.
# Smaller pieces cost too many packets and acknowledgements, so that only a slower link gets them: as much as it carries
# in PIECE_S, but at least LEAST_PIECE_BYTES. These fit into one TCP segment, and take 0.13 s at 64 kbit/s.
PIECE_BYTES = 16 * 1024
LEAST_PIECE_BYTES = 1024
PIECE_S = 0.026
# The window of unacknowledged bytes of pieces, all of which may be ahead of a small packet in the link: 0.1 s at
# 5 Mbit/s. 128 KiB were measured to double the time of a request there, for no more images. A slower link gets less: as
# much as it carries in WINDOW_S. A new link, whose rate is not known, begins with FIRST_WINDOW_BYTES, in pieces of
# FIRST_PIECE_BYTES: 0.5 s at 64 kbit/s, in four TCP segments, which even a short queue holds. One of 5 Mbit/s at 42 ms
# is full after 0.25 s, one of 50 Mbit/s at 0.1 s after 1.75 s.
WINDOW_BYTES = 64 * 1024
WINDOW_S = 0.1
FIRST_WINDOW_BYTES = 4 * 1024
FIRST_PIECE_BYTES = 1024
# The largest window, for a link that carries more in one round trip: 160 Mbit/s at 0.2 s, which is little memory.
MOST_WINDOW_BYTES = 4 * 1024 * 1024
# The fastest turn in rad/s with which `ros2_drive` steers back to its course or squares a line: within the limits of
# the policy profiles, which are applied before the drive begins.
STEER_MOST = 0.4
