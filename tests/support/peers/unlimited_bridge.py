"""The bridge with its limiter taken out: what the tests of limits must notice. It takes the rules and ignores them."""

from ros2_mcp_bridge.__main__ import main
from support.limits import without_limiter

with without_limiter():
    main()
