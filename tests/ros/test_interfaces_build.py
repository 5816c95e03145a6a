"""Interface packages are built for real, with this machine's compiler, and used by real nodes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rosidl_generator_py", reason="needs the interface generators of the ROS 2 wheels")

from ros2_mcp.commands.robots import ROBOTS
from ros2_mcp.link.diagnosis import diagnose
from ros2_mcp.link.environment import find_ros
from ros2_mcp.settings import Settings
from ros2_mcp_interfaces import BuildError, build, default_cache
from ros2_mcp_interfaces.cache import content_name
from ros2_mcp_interfaces.installation import find_installation
from ros2_mcp_interfaces.package import find_packages, left_out
from support.processes import peer_command

SHIPPED = Path(__file__).parents[2] / "src" / "ros2_mcp_demo" / "interfaces"
FOLLOW_HASH = "RIHS01_738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6"
"""Of control_msgs/action/FollowJointTrajectory, as released for ROS 2 Iron and Jazzy: as a build of it has it."""
TF_MESSAGE_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"

BUILD_S = 200
pytestmark = pytest.mark.timeout(2 * BUILD_S)

WARES = {
    "wares/msg/Item.msg": """# Größe “in” µm
string<=12 label "naïve"  # ° and 日本
float32[<=4] sizes [1.0, 2.0]
geometry_msgs/Point[2] corners
uint8 RED=1
""",
}
SHOP = {
    "shop/msg/Marker.msg": "builtin_interfaces/Time when\n",
    "shop/msg/Basket.msg": """std_msgs/Header header
wares/Item[] items
wares/Item[<=3] few
wares/Item best
Marker[2] markers
wstring wide
string[<=2] names
int64 big -9223372036854775808
""",
    "shop/srv/Count.srv": "Basket basket\n---\nint32 count\n",
    "shop/action/Fill.action": "int32 n\n---\nBasket basket\n---\nMarker marker\n",
}


def write(root, files):
    for name, text in files.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return root


def quiet(line):
    """Takes the progress of a build and says nothing."""


def builder(directory, cache, **environment):
    command = [sys.executable, "-m", "ros2_mcp_interfaces", str(directory), "--cache", str(cache)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env={**os.environ, **environment}, start_new_session=True, **pipes)


def outcome(process):
    out, err = process.communicate(timeout=BUILD_S)
    assert process.returncode == 0, err
    return [Path(line) for line in out.splitlines()], err


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """The sources of the two packages, the cache, and the prefixes built from them."""
    sources = write(tmp_path_factory.mktemp("sources"), {**SHOP, **WARES})
    cache = tmp_path_factory.mktemp("cache")
    prefixes, _ = outcome(builder(sources, cache))
    return sources, cache, prefixes


def test_nodes_exchange_messages_requests_and_goals_of_a_built_package(shop, domain_id):
    _, _, prefixes = shop
    environment = {
        **os.environ,
        "AMENT_PREFIX_PATH": os.pathsep.join(map(str, [*prefixes, sys.prefix])),
        "PYTHONPATH": os.pathsep.join(str(prefix / "site-packages") for prefix in prefixes),
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    command = peer_command("interfaces_peer")
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=BUILD_S, check=False)
    assert run.returncode == 0, run.stderr
    seen = json.loads(run.stdout)
    description = json.loads((prefixes[1] / "share" / "shop" / "msg" / "Basket.json").read_text())
    assert seen["message"] == {
        "equal": True,
        "x": 2.5,
        "sec": 7,
        "big": -(2**63),
        "hash": description["type_hashes"][0]["hash_string"],
    }
    assert seen["count"] == 1
    assert seen["goal"] == {"feedback": 3, "status": 4, "equal": True}
    assert seen["default_label"] == "naïve"
    assert set(SHOP) <= {f"shop/{name}" for name in seen["index"]}


def test_prefixes_come_in_dependency_order_and_carry_the_original_texts(shop):
    _, _, prefixes = shop
    assert [prefix.name.rpartition("-")[0] for prefix in prefixes] == ["wares", "shop"]
    installed = prefixes[0] / "share" / "wares" / "msg" / "Item.msg"
    assert installed.read_text(encoding="utf-8") == WARES["wares/msg/Item.msg"]


@pytest.mark.promise("README", "The robot's own interfaces are compiled once")
def test_a_second_build_needs_no_compiler(shop, tmp_path):
    sources, cache, prefixes = shop
    again, said = outcome(builder(sources, cache, PATH=str(tmp_path), CC="", CXX=""))
    assert again == prefixes
    assert said.split("\n")[:2] == ["wares: already built", "shop: already built"]


@pytest.mark.full
def test_a_second_build_takes_no_time(shop):
    sources, cache, _ = shop
    durations = []
    for _ in range(5):
        started = time.perf_counter()
        build([sources], cache, quiet)
        durations.append(time.perf_counter() - started)
    assert min(durations) < 0.1


def test_a_change_in_a_package_renews_it_and_all_that_use_it(shop, tmp_path):
    sources, _, prefixes = shop
    copy = Path(shutil.copytree(sources, tmp_path / "copy"))
    with (copy / "wares/msg/Item.msg").open("a") as file:
        file.write("# only a comment more\n")
    wares, user = find_packages([copy])
    renewed = content_name(wares, find_installation().with_package(prefixes[0]))
    assert renewed != prefixes[0].name
    shutil.copytree(prefixes[0], tmp_path / renewed)
    assert content_name(user, find_installation().with_package(tmp_path / renewed)) != prefixes[1].name
    assert content_name(user, find_installation().with_package(prefixes[0])) == prefixes[1].name


def test_tf2_msgs_from_the_shipped_definitions_is_the_type_that_every_robot_has():
    (prefix,) = build([SHIPPED / "tf2_msgs"], default_cache(), quiet)
    description = json.loads((prefix / "share/tf2_msgs/msg/TFMessage.json").read_text())
    assert description["type_hashes"][0] == {
        "type_name": "tf2_msgs/msg/TFMessage",
        "hash_string": TF_MESSAGE_HASH,
    }


def test_control_msgs_from_the_shipped_definitions_is_the_type_that_every_robot_has():
    (prefix,) = build([SHIPPED / "control_msgs"], default_cache(), quiet)
    description = json.loads((prefix / "share/control_msgs/action/FollowJointTrajectory.json").read_text())
    assert description["type_hashes"][0]["hash_string"] == FOLLOW_HASH


def test_what_the_demo_of_another_environment_built_is_used_by_every_installation_just_like_it(tmp_path):
    folder = tmp_path / "ros2-mcp" / "interfaces"
    folder.mkdir(parents=True)
    settings = Settings(cache_dir=folder.parent)
    env = {"PATH": os.environ["PATH"]}
    used = build([SHIPPED / name for name in ROBOTS["rover"]], default_cache(), quiet)
    (folder / "tf2_msgs-0123456789abcdef").mkdir()  # for another Python
    (folder / "in_use.json").write_text("{}")
    assert find_ros(settings, env).interface_prefixes == ()
    (told,) = (found for found in diagnose(settings, env) if found.title == "Built interfaces")
    assert told.detail == "in use here: none; built for other installations and not used here: tf2_msgs"
    assert "ros2-mcp interfaces build" in told.fix
    for prefix in used:
        (folder / prefix.name).symlink_to(prefix)
    assert {prefix.name for prefix in find_ros(settings, env).interface_prefixes} == {prefix.name for prefix in used}
    (told,) = (found for found in diagnose(settings, env) if found.title == "Built interfaces")
    assert told.detail == "in use here: ros2_mcp_demo_interfaces, tf2_msgs"


def test_after_a_killed_build_two_builders_at_once_build_once_and_mistake_nothing(tmp_path):
    sources, cache = write(tmp_path / "sources", WARES), tmp_path / "cache"
    killed = builder(sources, cache)
    assert "generating" in killed.stderr.readline()
    os.killpg(killed.pid, signal.SIGKILL)  # compilers that it has started would go on writing
    killed.communicate(timeout=BUILD_S)
    assert [path for path in cache.iterdir() if path.is_dir()]
    builders = [builder(sources, cache) for _ in range(2)]
    (first, said_first), (second, said_second) = map(outcome, builders)
    assert first == second == [path for path in cache.iterdir() if path.is_dir()]
    assert (said_first + said_second).count("built in") == 1
    assert (said_first + said_second).count("already built") == 1


REFUSED = {
    "a line that is no field": ("int32 a\n\nfloat64\n", 'Bad.msg line 3: "float64" is not understood', ""),
    "a default of the wrong kind": ("uint8 a 300\n", 'line 1: "uint8 a 300" is not understood', "float64 speed"),
    "a field twice": ("int32 a\nbool a\n", 'line 2: "a" is defined already in line 1', ""),
    "a Python keyword": ("int32 from\n", 'line 1: "from" is a word of the Python language', "another"),
    "an unknown type": (
        "geometry_msgs/Pont p\n",
        'field "p" is a geometry_msgs/Pont',
        "Did you mean geometry_msgs/Point?",
    ),
    "a header as in ROS 1": ("Header header\n", "bad has no message Header", "Did you mean std_msgs/Header?"),
    "a missing package": (
        "int32 a\nnowhere_msgs/Thing thing\n",
        'Bad.msg line 2: field "thing" is a nowhere_msgs/Thing, but there is no package nowhere_msgs',
        "Build nowhere_msgs in the same call",
    ),
}


@pytest.mark.parametrize("text,message,hint", REFUSED.values(), ids=REFUSED.keys())
def test_a_definition_that_cannot_be_built_is_named_with_its_line(tmp_path, text, message, hint):
    write(tmp_path, {"bad/msg/Bad.msg": text})
    with pytest.raises(BuildError) as caught:
        build([tmp_path / "bad"], tmp_path / "cache", quiet)
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert not (tmp_path / "cache").exists()


def test_a_service_without_its_separator_is_refused(tmp_path):
    write(tmp_path, {"bad/srv/Ask.srv": "string question\n"})
    with pytest.raises(BuildError, match=r"Ask\.srv has 0 lines '---' where there must be 1"):
        build([tmp_path / "bad"], tmp_path / "cache", quiet)


def test_packages_that_refer_to_each_other_are_refused(tmp_path):
    write(tmp_path, {"one/msg/A.msg": "two/B b\n", "two/msg/B.msg": "one/A a\n"})
    with pytest.raises(BuildError, match="in a circle: one -> two -> one"):
        build([tmp_path], tmp_path / "cache", quiet)


def test_a_package_of_the_installation_is_not_replaced(tmp_path):
    write(tmp_path, {"std_msgs/msg/Bool.msg": "uint8 data\n"})
    with pytest.raises(BuildError, match="std_msgs is part of the installation"):
        build([tmp_path / "std_msgs"], tmp_path / "cache", quiet)


@pytest.mark.promise("README", "with a C and C++ compiler and the headers of Python")
def test_a_machine_without_a_compiler_is_told_what_to_install(tmp_path, monkeypatch):
    write(tmp_path, WARES)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(BuildError, match="no C compiler found") as caught:
        build([tmp_path / "wares"], tmp_path / "cache", quiet)
    assert caught.value.hint == "sudo apt install build-essential"


@pytest.mark.parametrize(
    "sourced,message,hint",
    [
        (True, "no interface generators that can be used", "colcon build"),
        (False, "no ROS 2", "extra 'jazzy' of ros2-mcp"),
    ],
    ids=["normal ROS 2", "no ROS 2"],
)
def test_where_generators_are_missing_the_way_out_is_named(tmp_path, monkeypatch, sourced, message, hint):
    write(tmp_path, WARES)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path) if sourced else "")
    with pytest.raises(BuildError, match=message) as caught:
        build([tmp_path / "wares"], tmp_path / "cache", quiet)
    assert hint in caught.value.hint


KEYWORD = {
    "late_msgs/msg/Leg.msg": "int32 id\nint32 from  # where it begins\n",
    "late_msgs/msg/Way.msg": "string name\nLeg[] legs\n",
    "late_msgs/srv/Follow.srv": "int32 speed\n---\nlate_msgs/Way way\n",
}


def test_a_field_that_is_a_word_of_python_leaves_out_its_message_and_those_that_contain_it(tmp_path):
    write(tmp_path, {**KEYWORD, "late_msgs/msg/Part.msg": "int32 id\n", "late_msgs/srv/Stop.srv": "---\nPart part\n"})
    (package,) = find_packages([tmp_path])
    assert [file.name for file in package.files] == ["Part.msg", "Stop.srv"]
    told = {one.file.name: one.why for one in left_out([tmp_path])}
    assert sorted(told) == ["Follow.srv", "Leg.msg", "Way.msg"]
    assert told["Leg.msg"].startswith('line 2: "from" is a word of the Python language')
    assert "Leg" in told["Way.msg"] and "Way" in told["Follow.srv"]


def test_a_definition_that_cannot_be_built_is_named_as_left_out_with_an_exit_status(tmp_path):
    write(tmp_path, KEYWORD)
    idl = "module late_msgs { module msg { struct Status { double temperature; }; }; };\n"
    write(tmp_path, {"late_msgs/msg/Part.msg": "int32 id\n", "late_msgs/msg/Status.idl": idl})
    write(tmp_path, {"late_msgs/msg/Part.idl": "// made from Part.msg\n"})
    assert left_out([tmp_path])[0].file == tmp_path / "late_msgs" / "msg" / "Status.idl"
    process = builder(tmp_path / "late_msgs", tmp_path / "cache")
    out, err = process.communicate(timeout=BUILD_S)
    assert process.returncode == 2 and "late_msgs-" in out
    assert "Status.idl" in err and "Part.idl" not in err
    assert 'Leg.msg: line 2: "from"' in err and "Follow.srv" in err


def test_the_command_tells_errors_on_stderr_and_nothing_on_stdout(tmp_path):
    write(tmp_path, {"bad/msg/Bad.msg": "float64\n"})
    process = builder(tmp_path / "bad", tmp_path / "cache")
    out, err = process.communicate(timeout=BUILD_S)
    assert (process.returncode, out) == (1, "")
    assert err.startswith("error: ")
    assert "Bad.msg line 1" in err
