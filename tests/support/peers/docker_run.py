"""`docker run`, as far as the how-to uses it: reads the words as docker does, and starts the entry point.

The image is this environment: `ros2-mcp` of the Python that runs this. Nothing of the caller's environment gets in but
what PASSED names, as nothing would get into a container.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from support.containers import CONTAINER, ENTRYPOINT

FLAGS = ("-i", "--rm")
WITH_A_VALUE = ("--network", "--ipc", "--user", "-v", "-e")
IMAGE = "ros2-mcp"
PASSED = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOG_DIR",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "PYTHONPATH",
    "XDG_STATE_HOME",
)
"""What keeps tests apart from each other and from the machine's user."""


def main(words: list[str]) -> None:
    assert words[:1] == ["run"], words
    env = {name: os.environ[name] for name in PASSED if name in os.environ}
    env["PATH"] = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    rest = iter(words[1:])
    for word in rest:
        if word in FLAGS:
            continue
        if word == IMAGE:
            break
        assert word in WITH_A_VALUE, f"docker run has no option {word} here"
        value = next(rest)
        if word == "-e":
            name, equals, text = value.partition("=")
            env[name] = text if equals else os.environ[name]
        elif word == "-v" and value.startswith("/"):
            outside, inside, mode = value.split(":")
            assert Path(outside).exists() and inside == outside and mode == "ro", value
    else:
        raise AssertionError("no image is named")
    os.execvpe(CONTAINER[0], [*CONTAINER, ENTRYPOINT, *rest], env)


if __name__ == "__main__":
    main(sys.argv[1:])
