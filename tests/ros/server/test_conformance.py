"""The official conformance suite finds nothing but what docs/reference/conformance.md names, with the reason."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from support.ports import listening
from support.source import ROOT

PACKAGES = ("node@24", "@modelcontextprotocol/conformance@0.2.0-alpha.12")
"""The suite wants Node.js 22 or newer; the package brings one."""
# Some 130 MB from a registry that may be far away.
INSTALL_S = 600
# Fifty scenarios, some of which wait for what does not come; a minute was measured.
SUITE_S = 600
PROMPTS = {
    "test_simple_prompt": "---\ndescription: Simple\n---\nThis is a simple prompt.\n",
    "test_prompt_with_arguments": "---\ndescription: With arguments\narguments:\n"
    "  - name: arg1\n    description: One\n    required: true\n"
    "  - name: arg2\n    description: Two\n    required: true\n---\n{{arg1}} {{arg2}}\n",
}
"""The suite's own, made as users make theirs."""
pytestmark = [pytest.mark.full, pytest.mark.timeout(INSTALL_S + 2 * SUITE_S)]


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the suite's command and its Node.js."""
    if not shutil.which("npm"):
        pytest.skip("needs Node.js with npm")
    folder = tmp_path_factory.mktemp("conformance")
    install = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", *PACKAGES]
    subprocess.run(install, check=True, timeout=INSTALL_S, stdout=subprocess.DEVNULL)
    return folder / "node_modules/.bin"


def told(revision: str) -> set[str]:
    """The scenarios that fail for a revision, as the reference names them."""
    page = (ROOT / "docs/reference/conformance.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+) \|", page, re.MULTILINE)
    return {name for name, revisions in rows if revision in revisions}


@pytest.mark.parametrize("revision", ["2025-11-25", "2026-07-28"])
def test_only_what_the_reference_names_fails(suite: Path, ros_environment, revision: str, tmp_path: Path) -> None:
    for name, text in PROMPTS.items():
        (tmp_path / f"{name}.md").write_text(text)
    environment = {**os.environ, "PATH": f"{suite}:{os.environ['PATH']}"}
    options = ("--no-login", "--tools", "all", "--prompts", str(tmp_path))
    with listening(ros_environment, "streamable-http", *options) as (port, _):
        command = [str(suite / "conformance"), "server", "--url", f"http://localhost:{port}/mcp"]
        ended = subprocess.run(
            [*command, "--requirements", revision],
            env=environment,
            capture_output=True,
            text=True,
            timeout=SUITE_S,
            check=False,
        )
    summary = ended.stdout.partition("=== SUMMARY ===")[2].partition("Total:")[0]
    assert len(re.findall(r"^[✓✗] ", summary, re.MULTILINE)) > 30, ended.stdout + ended.stderr
    assert set(re.findall(r"^✗ ([\w-]+):", summary, re.MULTILINE)) == told(revision)
