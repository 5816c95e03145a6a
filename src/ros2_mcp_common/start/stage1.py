"""Stage 1: the program that runs first on the far side, before it is known whether there is a ROS 2, and where.

It is sent as text and executed by whichever python3 is there. So it needs only the standard library of Python 3.6, and
no other module of ours until they have been received. It reads a head and the bridge as a zip from its stdin, reports
its progress in lines that begin with a marker, and becomes the bridge; or it enters a container and leaves the rest to
a stage 1 there. It writes no file: the zip stays in memory. See
docs/decisions/0034-the-bridge-is-sent-and-not-installed.md.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from typing import Any

# The beginning of all lines of stage 1. A nonce follows, which is different each time, so that no noise is taken for
# one.
MARKER = b"\0ros2-mcp "
# The oldest Python that can search for ROS 2. Humble, the oldest supported ROS 2, has 3.10; the system's own Python,
# which only searches, may be older.
OLDEST_PYTHON = (3, 8)
# The longest time for the zip to arrive, and again from there to the bridge's hello, the same as the bridge's own
# limit: for setup files on a slow disk. Then the kernel ends a process that hangs, since the server may be gone.
ALARM_S = 30
# The period at which it is told how much of the zip has come.
TELLS_S = 0.5
# The program that the next Python executes: this same text, which is in its argument as base64.
AGAIN = "import base64,sys,zlib;line=sys.argv.pop().encode();exec(zlib.decompress(base64.b64decode(line)))"
# The newest name of a Python to look for (python3.16), and how many Pythons to try.
NEWEST_MINOR = 16
MOST_PYTHONS = 6
# The time limit for each: a Python starts in 20 ms, from an SD card in a second or two. Six of them fit under the
# alarm.
PYTHON_S = 3
# The descriptor of the zip is at least this: setup files may use descriptors given explicitly, which are below 10.
LOWEST_DESCRIPTOR = 60
# The time limit for a container engine: it answers within 0.1 s, but needs seconds if it is just being started.
ENGINE_S = 10
ENGINES = ("docker", "podman", "nerdctl")
# The errors of their clients in that case.
OF_AN_ENGINE_THAT_IS_DOWN = ("cannot connect to the docker daemon", "cannot connect to podman")
# Folders of engines that the PATH of a login without a terminal may lack.
ENGINE_FOLDERS = ("/usr/local/bin", "/usr/bin", "/snap/bin")

# Runs the bridge from its zip, first on the path; the working folder is not on it. The modules have to be compiled each
# time, which takes 0.15 s: a fork does it while this process loads what every bridge needs of ROS (whose output is kept
# out of the stream). This was measured to save 0.07 s of 0.8 s. zipimport compiles modules that the fork did not
# deliver, and if ROS cannot be loaded, the bridge reports the reason when it tries again.
RUN_BRIDGE = """\
import marshal, os, sys, zipimport
archive = sys.argv.pop(1)
sys.path[:] = [archive, *filter(None, sys.path)]
sys.argv[0] = archive + "/ros2_mcp_bridge/__main__.py"
reading, writing = os.pipe()
copy = os.fork()
if not copy:
    try:
        os.close(reading)
        import zipfile
        compiled = {}
        with zipfile.ZipFile(archive) as sources:
            for name in sources.namelist():
                compiled[name] = compile(sources.read(name), archive + "/" + name, "exec", dont_inherit=True)
        with open(writing, "wb") as out:
            out.write(marshal.dumps(compiled))
    finally:
        os._exit(0)
os.close(writing)
stream = os.dup(1)
os.dup2(2, 1)
try:
    import rclpy.node, geometry_msgs.msg
except Exception:  # only a head start: the bridge imports the same, and reports what is wrong
    pass
sys.stdout.flush()
os.dup2(stream, 1)
os.close(stream)
with open(reading, "rb") as told:
    text = told.read()
os.waitpid(copy, 0)
compiled = marshal.loads(text) if text else {}
class Compiled(zipimport.zipimporter):
    def get_code(self, name):
        file = name.replace(".", "/")
        found = compiled.get(file + ".py") or compiled.get(file + "/__init__.py")
        return found or super().get_code(name)
sys.path_hooks.insert(0, Compiled)
from ros2_mcp_bridge.__main__ import main
main()
"""


class Failed(Exception):
    """Raised if stage 1 cannot go on: why, for the user, and what to do."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


def main() -> None:
    """Read head and zip, then become the bridge. Report a failure and exit."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(ALARM_S)
    if sys.version_info[:2] < OLDEST_PYTHON:
        _become_newer()  # before anything else is read
    head = json.loads(_read_line())
    nonce = head["nonce"]
    # Before the zip is read, which takes 15 s at 64 kbit/s: the server waits for this line no longer than 12 s.
    tell(nonce, "reached", python=sys.version.split()[0], executable=sys.executable, machine=os.uname().machine)
    archive = _read(head["size"], nonce)
    signal.alarm(ALARM_S)
    try:
        if head["container"]:
            _enter_container(nonce, head["container"], head["words"])
        if sys.version_info[:2] < OLDEST_PYTHON:
            raise Failed(
                f"The python3 there is {sys.version.split()[0]}; "
                f"the oldest that will do is {'.'.join(map(str, OLDEST_PYTHON))}.",
                "ROS 2 from Humble on brings a newer one: put it on the PATH of that login.",
            )
        _become_bridge(nonce, _memory_file(zlib.decompress(archive)), head)
    except Failed as failed:
        tell(nonce, "failed", message=failed.message, hint=failed.hint)
        sys.exit(1)


def _become_newer() -> None:
    """Replace this process by a newer Python, if PATH has a newer Python; the alarm stays set."""
    own_text = globals().get("line")  # as received by the line of Python that executed this
    newer = _newer_python() if own_text else None
    if newer and own_text:
        os.execv(newer, [newer, "-ISc", AGAIN, own_text.decode().strip()])


def _newer_python() -> "str | None":
    """Return the first Python on PATH that is new enough, named `python3` or with its
    version; None if there is none.
    """
    names = ["python3"] + ["python3.%d" % minor for minor in range(NEWEST_MINOR, OLDEST_PYTHON[1] - 1, -1)]
    folders = [folder for folder in os.environ.get("PATH", os.defpath).split(os.pathsep) if folder] + ["/usr/bin"]
    paths = (shutil.which(name, path=folder) for folder in folders for name in names)
    is_new = "import sys;sys.exit(sys.version_info[:2] < %r)" % (OLDEST_PYTHON,)
    tried = 0
    for path in dict.fromkeys(filter(None, paths)):
        tried += 1
        if tried > MOST_PYTHONS:
            break
        try:
            asked = subprocess.run([path, "-ISc", is_new], stdin=subprocess.DEVNULL, timeout=PYTHON_S, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if asked.returncode == 0:
            return path
    return None


def tell(nonce: str, stage: str, **details: str) -> None:
    """Write one line to stdout: the marker, the nonce, and the stage reached."""
    text = json.dumps(dict(details, stage=stage))  # ASCII, in one line
    rest = MARKER + nonce.encode() + b" " + text.encode() + b"\n"
    while rest:
        rest = rest[os.write(1, rest) :]


def _read_line() -> bytes:
    """Read one line from stdin without a buffer: a buffer would swallow the bytes behind the line."""
    with open(0, "rb", buffering=0, closefd=False) as stream:
        return stream.readline()


def _read(size: int, nonce: str) -> bytes:
    """Read the zip. Over a slow link, report now and then how much has come: ssh gives up after 13 s without a reply,
    because its own keep-alive requests wait behind the zip.
    """
    data = b""
    told_s = time.monotonic()
    while len(data) < size:
        piece = os.read(0, size - len(data))
        if not piece:
            sys.exit(1)  # the server is gone
        data += piece
        if time.monotonic() - told_s > TELLS_S:
            told_s = time.monotonic()
            tell(nonce, "receiving", bytes=str(len(data)))
    return data


def _memory_file(data: bytes) -> str:
    """Return the path of a file without a folder; it lasts as long as a process has it open."""
    import fcntl  # not on Windows, where a server only reads this file

    try:
        made = os.memfd_create("ros2_mcp_bridge")
    except (AttributeError, OSError):  # a Python built for an older Linux (conda), or no Linux
        folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        with tempfile.TemporaryFile(dir=folder) as file:
            made = os.dup(file.fileno())
    descriptor = fcntl.fcntl(made, fcntl.F_DUPFD, LOWEST_DESCRIPTOR)  # inherited by children
    os.close(made)
    while data:
        data = data[os.write(descriptor, data) :]
    folder = "/proc/self/fd" if os.path.exists("/proc/self/fd") else "/dev/fd"
    return f"{folder}/{descriptor}"


def _become_bridge(nonce: str, archive: str, head: "dict[str, Any]") -> None:
    sys.path.insert(0, archive)
    from ros2_mcp_common.start import finding, nodes_here

    try:
        found = finding.find(finding.Search.from_json(head["search"]), dict(os.environ))
        argv, env = found.running([found.python, "-c", RUN_BRIDGE, archive, *head["options"]])
    except finding.NotFound as error:
        raise Failed(error.message, error.hint) from error
    tell(
        nonce,
        "found",
        kind=found.kind,
        distro=found.distro,
        prefix=str(found.prefix),
        python=found.python,
        why=found.why,
    )
    others = ", ".join(nodes_here.others_with_nodes())
    if others:
        tell(nonce, "others", users=others)
    env["PYTHONDONTWRITEBYTECODE"] = "1"  # nothing of ours stays there
    tell(nonce, "bridge")
    try:
        os.execvpe(argv[0], argv, env)
    except OSError as error:
        raise Failed(
            f"{argv[0]} cannot be executed there: {error.strerror}.",
            "Setup files are for bash: install it there." if argv[0] == "bash" else "Give another Python.",
        ) from error


# ── containers ─────────────────────────────────────────────────────────────────────────────────────────────────


def _enter_container(nonce: str, name: str, words: "list[str]") -> None:
    """Become the engine's client: the client starts another stage 1 in the container."""
    engine = _engine_of(name)
    tell(nonce, "container", name=name, engine=" ".join(engine))
    signal.alarm(0)  # the engine's client lives as long as the bridge
    os.execvp(engine[0], [*engine, "exec", "-i", name, *words])


def _engine_of(name: str) -> "list[str]":
    """Return the command of the engine in which this container runs. Raise `Failed` if there is none."""
    path = os.pathsep.join([os.environ.get("PATH", ""), *ENGINE_FOLDERS])
    engines = [[found] for found in (shutil.which(engine, path=path) for engine in ENGINES) if found]
    if not engines:
        raise Failed(
            f"No container engine is there ({', '.join(ENGINES)}).",
            "Leave ?container= out where ROS runs on the host itself, or install the engine's client.",
        )
    said, is_down = "", False
    while engines:
        engine = engines.pop(0)
        done = _ask(engine, "inspect", "--type", "container", "-f", "{{.State.Running}}", name)
        if done.returncode == 0 and done.stdout.strip() == "true":
            return engine
        if done.returncode == 0:
            raise Failed(f"The container {name} is not running.", f"Run there: {engine[0]} start {name}")
        said = said or _last_line(done.stderr)
        is_down = is_down or any(sign in done.stderr.lower() for sign in OF_AN_ENGINE_THAT_IS_DOWN)
        if "permission denied" in done.stderr.lower() and engine[0] != "sudo" and shutil.which("sudo"):
            engines.insert(0, ["sudo", "-n", *engine])
        elif "no such" in done.stderr.lower():
            running = _ask(engine, "ps", "--format", "{{.Names}}").stdout.split()
            said = f"there is none of that name; running: {', '.join(running) or 'none'}"
    if is_down:
        raise Failed(
            f"The host is reached, its container engine is not: {said.rstrip('.?')}.",
            "Start the engine there (sudo systemctl start docker), or say with DOCKER_HOST there where it is.",
        )
    raise Failed(
        f"The container {name} cannot be entered: {said.rstrip('.?')}.",
        "Look there with: docker ps. Where the engine denies it, add that user to the group docker.",
    )


def _ask(engine: "list[str]", *words: str) -> "subprocess.CompletedProcess[str]":
    try:
        return subprocess.run(
            [*engine, *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
            timeout=ENGINE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(engine, 1, "", str(error))


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["it says nothing"])[-1]


if __name__ == "__main__":
    main()
