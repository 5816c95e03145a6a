"""Two tours that are started at the same time do not meet."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.full
@pytest.mark.timeout(300)
def test_two_tours_at_the_same_time_are_in_two_domains_and_both_succeed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ros2_mcp", "demo"]
    tours = [
        subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for _ in range(2)
    ]
    said = [tour.communicate(timeout=240)[0] for tour in tours]
    assert [tour.returncode for tour in tours] == [0, 0], "\n".join(text[-2000:] for text in said)
    domains = [re.findall(r"ROS domain (\d+)", text)[0] for text in said]
    assert len(set(domains)) == 2 and len([*tmp_path.iterdir()]) == 2
