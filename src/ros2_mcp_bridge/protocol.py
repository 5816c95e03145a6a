"""The words of the stream that server and bridge share. See docs/reference/stream.md."""

from __future__ import annotations

# Said in `hello`; the server refuses a bridge of another number. It grows with every change that an older end of the
# stream would misunderstand.
PROTOCOL = 1
