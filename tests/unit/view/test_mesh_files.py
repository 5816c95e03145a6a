"""Which file a description's name means, and that no other one is read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.view.look import Chunks
from ros2_mcp.view.mesh_files import MeshFiles, file_of

STL = b"solid " + b"vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 "


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """An installation with one package that has one mesh."""
    folder = tmp_path / "install" / "share" / "body" / "meshes"
    folder.mkdir(parents=True)
    (folder / "arm one.stl").write_bytes(STL)
    (folder.parent / "secret.txt").write_bytes(STL)
    (tmp_path / "install" / "share" / "outside.stl").write_bytes(STL)
    os.mkfifo(folder / "pipe.stl")
    return tmp_path / "install"


def test_a_package_is_found_where_it_is_installed(prefix: Path) -> None:
    path = prefix / "share/body/meshes/arm one.stl"
    assert file_of("package://body/meshes/arm%20one.stl", [prefix.parent / "none", prefix]) == path
    assert file_of(f"file://{path}", []) == path


@pytest.mark.parametrize(
    "name",
    [
        *("", "arm.stl", "http://x/arm.stl", "package://", "package://body", "package:///etc/arm.stl"),
        *("package://body/secret.txt", "package://body/../outside.stl", "package://body/%2e%2e/outside.stl"),
        *(
            "package://other/meshes/arm.stl",
            "package://body/meshes",
            "package://body/none.stl",
            "package://body/pipe.stl",
        ),
        *("file://etc/arm.stl", "file:///etc/passwd", "file:///dev/zero", "package://body/a\0.stl"),
        "package://body/" + "x" * 1_000_000 + ".stl",
    ],
)
def test_no_other_file_is_meant(prefix: Path, name: str) -> None:
    with pytest.raises(BadData):
        file_of(name, [prefix])


async def test_each_is_read_once_and_what_cannot_be_read_says_why(prefix: Path) -> None:
    chunks = Chunks()
    files = MeshFiles(chunks, [prefix.parent])  # a workspace
    names = ["package://body/meshes/arm%20one.stl", "package://body/meshes/pipe.stl", "package://legs/leg.stl"]
    found = await files.read([*names, names[0]])
    facts, *reasons = found.values()
    assert isinstance(facts, dict) and (facts["triangles"], facts["vertices"]) == (1, 3)
    assert chunks.find(facts["key"]) is not None
    assert reasons == ["The package body on this machine has no such file.", "The package legs is not on this machine."]
    assert (await files.read(names))[names[0]] is facts
