"""Running the interface builder: as long as it makes progress."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ros2_mcp.link.interfaces import run_builder
from ros2_mcp.model.errors import LinkError
from ros2_mcp_interfaces.cache import one_builder
from ros2_mcp_interfaces.compile import Compiler


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_a_builder_may_take_longer_than_its_limit_while_it_reports_progress(capfd: pytest.CaptureFixture[str]) -> None:
    lines = "for _ in range(15): print('compiled', file=sys.stderr, flush=True); time.sleep(0.4)"
    code = f"import sys, time\n{lines}\nprint('{{}}')"
    said, exit_code = run_builder(python(code), {}, quiet=False, hangs_s=4.0)
    assert (said.strip(), exit_code) == (b"{}", 0)
    assert capfd.readouterr().err.count("compiled") == 15


def test_a_builder_without_progress_is_ended_and_what_to_do_is_told() -> None:
    with pytest.raises(LinkError, match="no progress for 1 s") as caught:
        run_builder(python("import time; time.sleep(600)"), {}, quiet=True, hangs_s=1.0)
    assert "kept" in caught.value.hint


def test_what_an_interrupted_build_compiled_is_not_compiled_again(tmp_path: Path) -> None:
    nobody = Compiler(["/nowhere/cc"], ["/nowhere/c++"])
    (tmp_path / "a.c.o").touch()
    assert nobody.compile(tmp_path / "a.c", []) == tmp_path / "a.c.o"
    cache = tmp_path / "cache"
    with pytest.raises(KeyboardInterrupt), one_builder(cache, "wares") as workspace:
        (workspace / "a.c.o").touch()
        raise KeyboardInterrupt
    with one_builder(cache, "wares") as workspace:
        assert (workspace / "a.c.o").is_file()
    assert not workspace.exists()
