"""Places by name, kept in the robot's folder of state."""

import json

import pytest

from ros2_mcp.guard.state import StateFolder
from ros2_mcp.model.errors import BadData, BadInput, NotFound
from ros2_mcp.ops.navigation.known_places import MOST_PLACES, NamedPlace, Places


def test_a_place_is_known_to_another_server_and_after_a_restart(tmp_path):
    folder = StateFolder(tmp_path / "robot")
    assert Places(folder).all() == []
    assert Places(folder).set(NamedPlace(" dock ", "map", 1.0, -2.5)) is None
    Places(folder).set(NamedPlace("door", "map", 0.0, 0.0, 1.5))
    assert Places(folder).set(NamedPlace("dock", "odom", 3.0, 0.0)) == NamedPlace("dock", "map", 1.0, -2.5)
    assert Places(folder).all() == [NamedPlace("dock", "odom", 3.0, 0.0), NamedPlace("door", "map", 0.0, 0.0, 1.5)]
    assert Places(folder).remove("DOOR").name == "door"
    with pytest.raises(NotFound, match="There is no place «door»"):
        Places(folder).remove("door")
    assert [path.name for path in folder.path.iterdir()] == ["places.json"]


def test_what_a_person_has_written_wrongly_is_told_and_not_overwritten(tmp_path):
    folder = StateFolder(tmp_path / "robot")
    Places(folder).set(NamedPlace("dock", "map", 1.0, 2.0))
    file = folder.path / "places.json"
    for damaged in ("{", "[]", json.dumps({"places": {"a": {"frame": "map", "x_m": "here", "y_m": 0}}})):
        file.write_text(damaged)
        with pytest.raises(BadData, match="damaged"):
            Places(folder).set(NamedPlace("other", "map", 0.0, 0.0))
        assert file.read_text() == damaged
    file.write_text('{"places": {"a": {"frame": "map", "x_m": NaN, "y_m": 0}}}')
    with pytest.raises(BadData, match="damaged"):
        Places(folder).all()


def test_a_file_that_is_a_link_is_not_followed(tmp_path):
    folder = StateFolder(tmp_path / "robot")
    folder.make()
    (tmp_path / "elsewhere").write_text('{"places": {}}')
    (folder.path / "places.json").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BadData, match="cannot be read"):
        Places(folder).all()


@pytest.mark.parametrize("name", ["", "  ", "a" * 81, "two\nlines", "hidden\u202e"])
def test_names_that_cannot_be_are_refused(name):
    with pytest.raises(BadInput):
        Places().set(NamedPlace(name, "map", 0.0, 0.0))


def test_there_are_not_more_than_the_limit():
    places = Places()
    for number in range(MOST_PLACES):
        places._in_memory[str(number)] = NamedPlace(str(number), "map", 0.0, 0.0)
    with pytest.raises(BadInput, match="Remove one"):
        places.set(NamedPlace("one more", "map", 0.0, 0.0))
    places.set(NamedPlace("7", "map", 1.0, 0.0))
    assert places.find("7").x_m == 1.0
