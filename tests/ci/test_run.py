"""`.ci/run` as a whole: its table of bounds, and its options."""

from __future__ import annotations

import re
import subprocess

from support.source import ROOT

SCRIPT = (ROOT / ".ci/run").read_text(encoding="utf-8")
MOST_S = 4300
"""In turn: 18 minutes less than the 90 after which CI ends a run, without saying where it stood."""


def bounds_s() -> dict[str, int]:
    return {name: int(bound) for name, bound in re.findall(r"^ +\[([^\]]+)\]=(\d+)$", SCRIPT, re.MULTILINE)}


def test_all_bounds_together_are_far_below_the_limit_of_ci() -> None:
    bounds = bounds_s()
    assert 0 < bounds.pop("everything") <= MOST_S
    assert sum(bounds.values()) < MOST_S


def test_every_step_has_a_bound_and_every_bound_a_step() -> None:
    used = re.findall(r'^ *(?:step|set_up|beside) ("[^"$]+(?: \$platform)?"|[a-z-]+) ', SCRIPT, re.MULTILINE)
    names = {name.strip('"') for name in used} - {"pyright $platform"} | {"pyright Darwin", "pyright Windows"}
    assert names | {"everything"} == bounds_s().keys()


def test_an_option_that_there_is_not_runs_nothing() -> None:
    asked = subprocess.run([ROOT / ".ci/run", "--quik"], capture_output=True, text=True, check=False, timeout=60)
    assert asked.returncode == 2
    assert "Usage: .ci/run [--quick]" in asked.stdout
