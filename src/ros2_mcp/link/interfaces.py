"""Interface packages for an installation from wheels: build them, and record which are in use."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

from ros2_mcp.link.installation import RosInstallation
from ros2_mcp.model.errors import LinkError

SHIPPED = Path(__file__).resolve().parents[2] / "ros2_mcp_demo" / "interfaces"
"""The sources of the packages that come with ros2-mcp: interfaces of the simulated robot that no wheel has."""
HANGS_S = 900.0
"""A build that reports no progress for this long hangs. As a whole it may take as long as it needs: a package with many
interfaces compiles for minutes on a small machine, and each line says how far it is."""
_LOOKS_S = 1.0
_DIGEST = re.compile(r"-[0-9a-f]{16}$")


@dataclass(frozen=True, slots=True)
class InterfaceCache:
    """The folder of built packages, and the record of the packages that each installation uses."""

    folder: Path

    def in_use(self, prefix: Path) -> tuple[Path, ...]:
        """Return the packages that were built for the installation with that prefix and still exist."""
        recorded = self._record().get(str(prefix), {})
        return tuple(built for path in recorded.values() if (built := Path(path)).is_dir())

    def shipped(self) -> tuple[Path, ...]:
        """Return the shipped packages that were built for an installation equal to this Python's.

        The simulated robot of another environment may have built them; its messages can then be read here as well.
        """
        if self.names().isdisjoint(sources.name for sources in SHIPPED.iterdir()):
            return ()  # without a closer look, which would slow down each start

        from ros2_mcp_interfaces import BuildError, finished

        try:
            return tuple(finished([SHIPPED], self.folder))
        except BuildError:
            return ()

    def planned(self, packages: Sequence[str]) -> tuple[Path, ...]:
        """Return the prefixes of packages in `SHIPPED`: prefixes that exist, or will exist once the packages are built
        for this Python.

        Empty if nothing can be built for it.
        """
        from ros2_mcp_interfaces import BuildError, planned

        try:
            return tuple(planned([SHIPPED / package for package in packages], self.folder))
        except BuildError:
            return ()

    def names(self) -> set[str]:
        """Return the names of all built packages, for any installation."""
        return {package_name(built) for built in self.folder.glob("[!.]*-*") if built.is_dir()}

    def use(self, prefix: Path, packages: Sequence[Path]) -> None:
        """Record packages as in use by an installation; a package replaces a package with the same name."""
        record = self._record()
        mine = record.setdefault(str(prefix), {})
        mine.update({package_name(package): str(package) for package in packages})
        text = json.dumps(record, indent=1)
        draft = self._file.with_suffix(".draft")
        draft.write_text(text)
        draft.replace(self._file)

    @property
    def _file(self) -> Path:
        return self.folder / "in_use.json"

    def _record(self) -> dict[str, dict[str, str]]:
        try:
            found: Any = json.loads(self._file.read_text())
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}  # pyright: ignore[reportUnknownVariableType]


def package_name(prefix: Path) -> str:
    """Return the name of the package in a prefix: the folder's name without the digest of the cache, if present."""
    return _DIGEST.sub("", prefix.name)


def curing(package: str) -> str:
    """Return how to install an interface package that the bridge does not know, for each kind of installation."""
    sources = SHIPPED / package
    folder = str(sources) if sources.is_dir() else "DIR (the folder with its .msg files)"
    return (
        f"The package {package} is not there. With ROS 2 from wheels run: ros2-mcp interfaces build {folder}; with any "
        "other, install it or source its workspace (--workspace DIR). Then start this server again."
    )


class Built(NamedTuple):
    """The prefixes of built packages, and the definitions in them that cannot be built here."""

    packages: Sequence[Path]
    left_out: Sequence[Path]


def build(
    installation: RosInstallation, directories: Sequence[Path], cache: InterfaceCache, *, quiet: bool = False
) -> Built:
    """Build the packages below the directories, unless they are built already, and record them as in use.

    Raises:
        LinkError: with the message of the compiler or generator, if one cannot be built; or if the build hangs. What
            was compiled is kept for the next one.
    """
    cache.folder.mkdir(parents=True, exist_ok=True)
    words = [*(str(directory.resolve()) for directory in directories), "--cache", str(cache.folder), "--json"]
    command = installation.command("ros2_mcp_interfaces", words)
    said, code = run_builder(command.argv, command.env, quiet=quiet)
    try:
        answer: dict[str, Any] = json.loads(said)
    except ValueError as error:
        raise LinkError(f"The interface builder ended with code {code} and said nothing.") from error
    if "prefixes" not in answer:
        raise LinkError(f"The interfaces cannot be built: {answer['error']}", answer.get("hint", ""))
    packages = [Path(path) for path in answer["prefixes"]]
    cache.use(installation.prefix, packages)
    return Built(packages, [Path(path) for path in answer["left_out"]])


def run_builder(
    argv: Sequence[str], env: Mapping[str, str], *, quiet: bool, hangs_s: float = HANGS_S
) -> tuple[bytes, int]:
    """Run the builder; return its output and exit code. Its progress goes to stderr, unless `quiet`.

    Raises:
        LinkError: if it reports no progress for `hangs_s`; it is ended then.
    """
    heard_at = time.monotonic()

    def pass_on(lines: IO[bytes]) -> None:
        nonlocal heard_at
        for line in lines:
            heard_at = time.monotonic()
            if not quiet:
                sys.stderr.write(line.decode(errors="replace"))
                sys.stderr.flush()

    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen(
            argv, env=dict(env), stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.PIPE
        ) as process,
    ):
        assert process.stderr is not None
        following = threading.Thread(target=pass_on, args=(process.stderr,), daemon=True)
        following.start()
        try:
            while process.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_LOOKS_S)
                if process.poll() is None and time.monotonic() - heard_at > hangs_s:
                    raise LinkError(
                        f"The interface builder was ended: it reported no progress for {hangs_s:g} s.",
                        "What it had compiled is kept: run ros2-mcp interfaces build again, best on a quieter machine.",
                    )
        finally:
            process.kill()  # nothing happens if it has ended
            following.join(_LOOKS_S)
        output.seek(0)
        return output.read(), process.returncode
