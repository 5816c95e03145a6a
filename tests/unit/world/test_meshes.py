"""Files of meshes become few triangles, and what is no mesh breaks nothing."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from ros2_mcp.model.errors import BadData
from ros2_mcp.world.meshes import packed_mesh, parts_of

CORNERS = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)]
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [(face[0], face[at], face[at + 1]) for face in FACES for at in (1, 2)]


def stl() -> bytes:
    """A box of 1 m × 2 m × 3 m."""
    rows = [struct.pack("<12fH", 0, 0, 0, *(part for at in one for part in CORNERS[at]), 0) for one in TRIANGLES]
    return b"solid, which many binary files begin with".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def text_stl() -> bytes:
    facets = "".join(
        f"facet normal 0 0 0 outer loop {' '.join(f'vertex {x} {y} {z}' for x, y, z in (CORNERS[at] for at in one))} "
        "endloop endfacet "
        for one in TRIANGLES
    )
    return f"solid box {facets} endsolid".encode()


def dae(*, corners: str = "", unit: float = 0.001, inside: str = "") -> bytes:
    """The same in millimetres, red, moved by 10 m along x."""
    numbers = " ".join(str(part / unit) for corner in CORNERS for part in corner)
    polygons = " ".join(str(at) for face in FACES for at in face)
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<asset><unit meter="{unit}"/><up_axis>Y_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique><phong><diffuse><color>1 0 0 1</color></diffuse></phong>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f">{corners or numbers}</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist material="red" count="6"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4 4 4 4 4 4</vcount>
<p>{polygons}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="n"><translate>{10 / unit} 0 0</translate>
<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="red" target="#m"/>
</technique_common></bind_material></instance_geometry>{inside}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>""".encode()


def obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [
        f"f {' '.join(f'{at + 1}//1' for at in face)}" for face in FACES
    ]
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("suffix", "data", "low"), [(".STL", stl(), 0), (".stl", text_stl(), 0), (".dae", dae(), 10), (".obj", obj(), 0)]
)
def test_a_box_is_a_box_in_each_format(suffix: str, data: bytes, low: float) -> None:
    made = packed_mesh(parts_of(data, suffix), 1000)
    assert (made.vertices, made.triangles, made.of_triangles, made.has_colours) == (8, 12, 12, suffix == ".dae")
    raw = zlib.decompress(made.data)
    corners = np.frombuffer(raw, "<u4", 36)
    places = np.frombuffer(raw, "<u2", 24, 36 * 4).reshape(-1, 3) * made.step + made.low
    assert corners.max() == 7
    assert {tuple(place) for place in places.round(3)} == {(x + low, y, z) for x, y, z in CORNERS}
    if made.has_colours:
        assert raw[-24:] == b"\xff\x00\x00" * 8


def test_a_fine_mesh_gets_coarser_and_keeps_its_size() -> None:
    across, up = np.meshgrid(np.linspace(0, 2 * np.pi, 200), np.linspace(0.05, np.pi - 0.05, 200))
    xyz = np.stack([np.cos(across) * np.sin(up), np.sin(across) * np.sin(up), np.cos(up)], axis=-1).reshape(-1, 3)
    at = (np.arange(199)[:, None] * 200 + np.arange(199)).reshape(-1, 1)
    triangles = np.concatenate([at + np.array(one) for one in ((0, 1, 200), (1, 201, 200))])
    rows = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"] = xyz[triangles]
    data = bytes(80) + struct.pack("<I", len(rows)) + rows.tobytes()
    made = packed_mesh(parts_of(data, ".stl"), 5000)
    assert 1000 < made.triangles <= 5000 and made.of_triangles == len(triangles)
    assert [step * 65535 for step in made.step] == pytest.approx([2.0, 2.0, 2.0], abs=0.02)


@pytest.mark.parametrize(
    ("suffix", "data"),
    [
        *((".stl", b""), (".stl", stl()[:-1]), (".stl", b"solid x"), (".stl", b"solid vertex 1 2 x"), (".zip", stl())),
        (".stl", b"solid " + b"vertex nan inf 1e999 " * 3),
        (".stl", bytes(80) + b"\xff\xff\xff\xff"),
        *((".dae", b""), (".dae", b"<COLLADA/>"), (".dae", b'<!DOCTYPE x [<!ENTITY a "aa">]><COLLADA/>')),
        (".dae", dae(corners="1 2")),
        (".dae", dae(corners="0 0 0")),
        (".dae", dae(corners="x")),
        (".dae", dae(inside="<node>" * 100 + "</node>" * 100)),
        (".dae", dae(inside='<instance_geometry url="#g"/>' * 3000)),
        (".dae", dae(inside='<instance_node url="#n"/>')),
        *(
            (".obj", b"v 1 2"),
            (".obj", b"v 1 2 3\nf 1 2 3"),
            (".obj", b"v 0 0 0\n" * 3 + b"f 1 2 99999999999999999999"),
        ),
    ],
)
def test_what_is_no_mesh_is_refused(suffix: str, data: bytes) -> None:
    with pytest.raises(BadData):
        parts_of(data, suffix)
