"""A test that leaves a process, or something in shared memory, fails itself: shown by planted ones in a pytest."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from support import own_processes, shared_memory
from support.domains import reserved_domains
from support.processes import python_path

pytest.importorskip("rclpy", reason="needs the ROS 2 wheels, or a sourced ROS 2")

REPEATS = {"CI", "BUILD_NUMBER"}
"""With one of these pytest tells each error whole a second time, in its summary."""
CONFTEST = """
import subprocess, sys
import pytest
from support import own_processes, shared_memory
from support.domains import reserved_domains

own_processes.END_S = 3.0

@pytest.fixture(scope="module")
def domain():
    with reserved_domains() as first:
        yield first

@pytest.fixture(scope="module")
def of_the_module():
    process = subprocess.Popen(["sleep", "1001"])
    yield process
    process.kill()
    process.wait()

@pytest.fixture
def shell():
    return lambda text: subprocess.run(["bash", "-c", text], check=True)

@pytest.fixture
def node(domain):
    def begin(end):
        text = f"import os, sys, time, rclpy; rclpy.init(domain_id={domain}); node = rclpy.create_node('planted')\\n"
        command = [sys.executable, "-c", f"{text}print('ready', flush=True); sys.stdin.read(); {end}"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert process.stdout.readline()
        return process
    return begin
"""

PLANTED = {
    "test_a_process": """
def test_leaves_nothing_before(of_the_module):
    pass

def test_leaves_one(of_the_module, shell):
    shell("setsid sleep 1002 >/dev/null 2>&1 &")

def test_does_not_see_it():
    import subprocess
    assert "sleep 1002" not in subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout.splitlines()

def test_waits_for_one_that_ends_soon(shell):
    shell("setsid sleep 0.5 >/dev/null 2>&1 &")

def test_uses_what_is_left_to_the_module(of_the_module):
    pass
""",
    "test_a_module": """
import subprocess
import time
import pytest

@pytest.fixture(scope="module")
def careless():
    subprocess.run(["bash", "-c", "setsid sleep 1003 >/dev/null 2>&1 &"])

@pytest.fixture(scope="module")
def parent():
    return subprocess.Popen(["bash", "-c", "setsid sleep 1005 & echo; wait"], stdout=subprocess.PIPE)

def test_begins(careless):
    time.sleep(0.05)  # the kernel tells in hundredths of a second when a process began

def test_kills_the_parent_of_one_of_the_module(parent):
    assert parent.stdout.readline()
    parent.kill()
    parent.wait()

def test_ends(careless):
    pass
""",
    "test_the_end": """
def test_whose_fixture_fails_too(request, shell):
    request.addfinalizer(lambda: 1 / 0)
    shell("setsid sleep 1004 >/dev/null 2>&1 &")
""",
    "test_a_held_port": """
HOLD = '''
import mmap, os, sys, time
port = open(sys.argv[1], "w+b")
port.truncate(4096)
memory = mmap.mmap(port.fileno(), 4096)
os.close(1)
time.sleep(5)
'''

def test_of_one_that_is_not_found(domain):
    import subprocess, sys
    path = f"/dev/shm/fastrtps_port{7400 + 250 * (domain + 2) + 249}"
    daemon = ["env", "-i", "setsid", "--fork", sys.executable, "-c", HOLD, path]
    subprocess.run(daemon, stdout=subprocess.PIPE, check=True)
""",
    "test_a_node": """
def test_leaves_in_order(node):
    process = node("node.destroy_node(); rclpy.shutdown(); os._exit(0)")
    assert not process.communicate()[0]

def test_is_killed(node):
    process = node("")
    process.kill()
    process.wait()
""",
    "test_a_careless_node": """
def test_is_fine(node):
    process = node("node.destroy_node(); rclpy.shutdown(); os._exit(0)")
    process.communicate()

HEARD = "heard = lambda: node.count_publishers('/rosout') == 2; [time.sleep(0.05) for _ in iter(heard, True)]"

def test_leaves_no_ros(node, request):
    for end in ("node.destroy_node(); rclpy.shutdown(); os._exit(0)", f"{HEARD}; os._exit(0)"):
        request.addfinalizer(node(end).communicate)

def test_is_fine_again(node):
    pass
""",
}


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What a pytest of these tests says."""
    folder = tmp_path_factory.mktemp("planted")
    (folder / "pytest.ini").touch()
    (folder / "conftest.py").write_text(CONFTEST)
    for name, text in PLANTED.items():
        (folder / f"{name}.py").write_text(text)
    options = ["-p", "support.leaves_nothing", "-p", "no:cacheprovider", "-rEp", "--tb=short", "-n0"]
    told_once = {name: value for name, value in os.environ.items() if name not in REPEATS}
    environment = {**told_once, "PYTHONPATH": python_path(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command = [sys.executable, "-m", "pytest", *options, str(folder)]
    ran = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)
    return ran.stdout + ran.stderr


def test_only_those_fail_that_have_left_something(said: str) -> None:
    failed = set(re.findall(r"^ERROR (\S+)", said, re.MULTILINE))
    assert failed == {
        "test_a_process.py::test_leaves_one",
        "test_a_module.py::test_kills_the_parent_of_one_of_the_module",
        "test_a_module.py::test_ends",
        "test_the_end.py::test_whose_fixture_fails_too",
        "test_a_held_port.py::test_of_one_that_is_not_found",
        "test_a_careless_node.py::test_is_fine_again",
    }, said
    assert len(re.findall(r"^PASSED ", said, re.MULTILINE)) == sum(text.count("def test_") for text in PLANTED.values())


@pytest.mark.parametrize(
    ("process", "by"),
    [
        ("sleep 1002", "test_a_process.py::test_leaves_one"),
        ("sleep 1003", "test_a_module.py::test_begins"),
        ("sleep 1005", "test_a_module.py::test_kills_the_parent_of_one_of_the_module"),
        ("sleep 1004", "test_the_end.py::test_whose_fixture_fails_too"),
    ],
)
def test_a_process_that_is_left_is_named_with_the_test_in_whose_time_it_began_and_killed(
    said: str, process: str, by: str
) -> None:
    (pid,) = re.findall(rf"(\d+) \({process}\), in state S, started \d+\.\d s ago in the time of {by}", said)
    assert own_processes.process(int(pid)) is None


def test_what_failed_at_the_end_of_the_test_is_told_beside_what_was_left(said: str) -> None:
    assert "ZeroDivisionError" in said


def test_who_has_a_port_open_in_the_domain_is_named(said: str) -> None:
    assert re.search(r"\d+ \(\S*python.* still has open fastrtps_port\d+", said), said


def test_who_ends_without_leaving_ros_is_named_unless_a_test_killed_it(said: str) -> None:
    assert said.count("did not leave ROS") == 1, said
    at = r"began in the time of test_a_careless_node\.py::test_leaves_no_ros"
    assert re.search(rf"\d+ \(.*\) did not leave ROS at its end, though no test killed it: it {at}", said), said


def test_the_segment_of_who_did_not_leave_is_removed(said: str) -> None:
    (path,) = re.findall(r"has left (/dev/shm/\w+)", said)
    assert not Path(path).exists()


def test_ports_that_the_killed_have_left_are_gone_after_the_block_and_those_of_other_domains_stay() -> None:
    with reserved_domains() as mine, reserved_domains() as other:
        left, kept = (7400 + 250 * domain + 249 for domain in (mine + 2, other))
        files = [Path(f"/dev/shm/{name}") for name in (f"fastrtps_port{left}", f"sem.fastrtps_port{left}_mutex")]
        stays = Path(f"/dev/shm/fastrtps_port{kept}")
        for file in (*files, stays):
            file.touch()
        shared_memory.remove_ports([mine, mine + 1, mine + 2])
        assert not [file for file in files if file.exists()]
        assert stays.exists()
    assert not stays.exists()
