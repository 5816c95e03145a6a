"""Functions of programs for clouds, grids and bytes: computed here with NumPy, because the sandbox has no such library.

Each takes a message as the program received it, live or from a recording, and returns plain numbers.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

from ros2_mcp.model.aside import aside, load
from ros2_mcp.model.errors import BadData, BadInput
from ros2_mcp.model.occupancy import OCCUPIED_FROM, MapFacts
from ros2_mcp.model.text import counted
from ros2_mcp.programs.declare import Use, function

if TYPE_CHECKING:
    from ros2_mcp.world.occupancy import OccupancyGrid

T = TypeVar("T")
Message = Mapping[str, Any]

MOST_POINTS = 50_000
"""The most points in one list: 10 MB in the sandbox, which has 64 MB."""
USUAL_POINTS = 20_000
"""The default: enough for a plane or a cluster, and returned within 0.1 s."""
MOST_CELLS = 250_000
"""The most cells in the rows of a grid: 500 × 500, 25 m × 25 m in most maps."""
MOST_GRID_CELLS = 25_000_000
"""The most cells of a grid that the functions accept: 5000 × 5000."""
MOST_VALUES = 100_000
"""The most values of one `unpack`."""
_MOST_FORMAT = 100
"""The longest format, in characters."""
_MOST_FIELDS = 20
_CODE = re.compile(r"(\d*)([xcbB?hHiIlLqQnNefdspP])")

KINDS: Mapping[str, tuple[int, int]] = {
    "occupied": (OCCUPIED_FROM, 100),
    "free": (0, OCCUPIED_FROM - 1),
    "unknown": (-128, -1),
}
"""The range of cell values of each kind, both ends included."""


@function()
async def points(
    use: Use,
    cloud: Message,
    fields: Sequence[str] = (),
    stride: int | None = None,
    limit: int = USUAL_POINTS,
) -> list[tuple[float, ...]]:
    """The points of a PointCloud2 message, each as (x, y, z, followed by the given fields).

    Points that are not finite are omitted. If there are more than limit (at most 50,000), every stride-th point is
    returned, and a note in the result says so. A packed rgb is 0xRRGGBB.
    """
    _whole("limit", limit, 1, MOST_POINTS)
    if stride is not None:
        _whole("stride", stride, 1, 1_000_000)
    if not isinstance(fields, (list, tuple)) or len(fields) > _MOST_FIELDS:
        raise BadInput(f"robot.points: fields is a list of at most {_MOST_FIELDS} names.")
    await load("ros2_mcp.world.clouds")
    from ros2_mcp.world.clouds import points_of

    message = _object(use, "points", cloud, "PointCloud2", ("fields", "height", "width", "point_step", "row_step"))
    found = await _computed("points", len(message.data), points_of, message, list(fields), stride, limit)
    if len(found.rows) < found.finite:
        which = f"every {found.stride}th" if found.stride > 1 else "the first ones"
        use.tell(
            f"robot.points gave {len(found.rows)} of {found.finite} points ({which}): stride and limit choose others."
        )
    return list(found.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class GridFacts(MapFacts):
    """An occupancy grid: metres per cell, size in cells, the pose of the corner of cell (0, 0), and shares of all
    cells.

    `held` is the number by which the other grid functions find its cells.
    """

    held: int


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestCell:
    """The centre of a cell in the frame of the grid, its distance, and its value."""

    x: float
    y: float
    distance_m: float
    value: int


@function()
async def grid(use: Use, message: Message) -> GridFacts:
    """Read a map or costmap (OccupancyGrid) for grid_value, grid_nearest and grid_rows; returns its frame and size."""
    found = await _grid_of(use, "grid", message)
    facts = await _computed("grid", found.cells.size, found.facts)
    rounded = {name: round(getattr(facts, name), 6) for name in ("free", "occupied", "unknown")}
    numbers: dict[str, Any] = {**asdict(facts), **rounded, "resolution_m": float(f"{facts.resolution_m:.7g}")}
    return GridFacts(**numbers, held=use.held.hold(found, int(found.cells.nbytes)))


@function()
async def grid_value(use: Use, grid: Message, x: float, y: float) -> int | None:
    """The value of the cell at a position (m): -1 unknown, 0 free to 100 occupied; None outside the grid."""
    found = await _grid_of(use, "grid_value", grid)
    return await _computed("grid_value", 0, found.value, x, y)


@function()
async def grid_nearest(
    use: Use, grid: Message, x: float, y: float, kind: Literal["occupied", "free", "unknown"] = "occupied"
) -> NearestCell | None:
    """The cell of a kind that is nearest to a position (m); None if there is none. Occupied means 50 or more."""
    if kind not in [*KINDS]:
        raise BadInput(f"robot.grid_nearest: kind is one of {', '.join(KINDS)}.")
    found = await _grid_of(use, "grid_nearest", grid)
    place = await _computed("grid_nearest", found.cells.size, found.nearest, x, y, *KINDS[kind])
    if place is None:
        return None
    at_x, at_y = found.point(*place)
    away_m = ((at_x - x) ** 2 + (at_y - y) ** 2) ** 0.5
    return NearestCell(
        x=round(at_x, 4), y=round(at_y, 4), distance_m=round(away_m, 4), value=int(found.cells[place[0], place[1]])
    )


@function()
async def grid_rows(use: Use, grid: Message, stride: int | None = None) -> list[list[int]]:
    """The values of a grid by rows: rows[0] has the smallest y, and rows[0][0] is the cell at the origin.

    With a stride each value is the largest of stride × stride cells. Without one, the stride is the smallest that gives
    at most 250,000 values; a note in the result says so.
    """
    found = await _grid_of(use, "grid_rows", grid)
    height, width = found.cells.shape
    least = 1
    while -(-height // least) * -(-width // least) > MOST_CELLS:
        least += 1
    if stride is None:
        stride = least
        if stride > 1:
            use.tell(
                f"robot.grid_rows: each value is the largest of {stride} × {stride} of the {width} × {height} cells."
            )
    _whole("stride", stride, least, 1_000_000)
    return await _computed("grid_rows", found.cells.size, found.rows, stride)


@function()
async def unpack(
    use: Use,
    format: str,  # noqa: A002 - as that of struct
    data: Any,
    offset: int = 0,
    count: int | None = None,
    step: int | None = None,
) -> list[Any]:
    """Unpack numbers from bytes, by a format of Python's struct: unpack("<Hf", m["data"], offset=8) is [7, 1.5].

    With count it returns a list of that many records, which begin step bytes apart (default: the size of a record). "<"
    is little-endian, ">" big-endian; H is uint16, f float32, d float64.
    """
    content = use.held.get(data)
    if isinstance(content, list):
        try:
            content = bytes(cast("list[int]", content))
        except (TypeError, ValueError) as error:
            raise BadInput("robot.unpack: data is not a list of bytes: it has other values than 0 to 255.") from error
    elif not isinstance(content, bytes):
        if not hasattr(content, "nbytes"):
            raise BadInput("robot.unpack: data is bytes, such as those of a field uint8[].", 'As m["data"].')
        content = memoryview(content)
    if not isinstance(cast("Any", format), str) or len(format) > _MOST_FORMAT:
        raise BadInput(f"robot.unpack: the format is a string of at most {_MOST_FORMAT} characters.", 'Such as "<Hf".')
    try:
        record = struct.Struct(format)
    except struct.error as error:
        raise BadInput(f"robot.unpack: {format!r} is not a format: {error}.", 'Such as "<Hf".') from error
    records = 1 if count is None else count
    _whole("count", records, 1, MOST_VALUES)
    if not record.size or records * _values_of(format) > MOST_VALUES:
        raise BadInput(f"robot.unpack gives 1 to {MOST_VALUES} values.", "Give a smaller count.")
    step = record.size if step is None else step
    _whole("step", step, 1, 2**31)
    _whole("offset", offset, 0, 2**40)
    size = content.nbytes if isinstance(content, memoryview) else len(content)
    needed = offset + (records - 1) * step + record.size
    if needed > size:
        raise BadInput(
            f"robot.unpack: data has {size} bytes, and {needed} are needed: offset {offset}, "
            f"{counted(records, 'record')} of {record.size} bytes, {step} apart."
        )

    def unpacked() -> list[Any]:
        flat = content.cast("B") if isinstance(content, memoryview) else content
        return [list(record.unpack_from(flat, offset + step * number)) for number in range(records)]

    found = await _computed("unpack", records * record.size, unpacked)
    return found[0] if count is None else found


# ── messages from the program ────────────────────────────────────────────────────────────────────────────────────────


def _values_of(format_text: str) -> int:
    """Return how many values a record of a format has."""
    codes: Iterable[tuple[str, str]] = _CODE.findall(format_text)
    return sum(0 if code == "x" else 1 if code in "sp" else int(times or 1) for times, code in codes)


async def _grid_of(use: Use, name: str, value: Message) -> OccupancyGrid:
    """Return a grid that is held, or the grid in a message."""
    await load("ros2_mcp.world.occupancy")
    from ros2_mcp.world.occupancy import OccupancyGrid

    kept = use.held.get(value)
    if isinstance(kept, OccupancyGrid):
        return kept
    message = _object(use, name, value, "OccupancyGrid", ("header", "info"))
    if len(message.data) > MOST_GRID_CELLS:
        raise BadInput(f"robot.{name}: the grid has {len(message.data)} cells, more than {MOST_GRID_CELLS}.")
    return await _computed(name, len(message.data), OccupancyGrid, message)


def _object(use: Use, name: str, value: Any, type_name: str, needed: Sequence[str]) -> Any:
    """Return a message as an object with attributes, with `data` as an array. Raises `BadInput` for a missing field."""
    import numpy as np

    if not isinstance(value, Mapping):
        raise BadInput(f"robot.{name} takes a message of {type_name}, not {type(value).__name__}.")
    fields = cast("Mapping[str, Any]", value)
    if missing := [each for each in (*needed, "data") if each not in fields]:
        hint = "Read it without fields." if "_topic" in fields else ""
        raise BadInput(f"robot.{name} takes a message of {type_name}: this one has no field {missing[0]}.", hint)
    data = use.held.get(fields["data"])
    try:
        if isinstance(data, (bytes, bytearray)):
            data = np.frombuffer(data, np.uint8)
        elif isinstance(data, list):
            data = np.asarray(data, np.int8 if type_name == "OccupancyGrid" else np.uint8)
    except (ValueError, TypeError, OverflowError) as error:
        raise BadInput(f"robot.{name}: data is not a list of bytes: {error}.") from error
    if not isinstance(data, np.ndarray):
        raise BadInput(f"robot.{name}: data is {type(data).__name__}, not bytes or numbers.")
    rest = {key: _attributes(part) for key, part in fields.items() if key != "data"}
    return SimpleNamespace(**rest, data=cast("Any", data))


def _attributes(value: Any) -> Any:
    if isinstance(value, Mapping):
        parts = cast("Mapping[str, Any]", value)
        return SimpleNamespace(**{key: _attributes(part) for key, part in parts.items()})
    if isinstance(value, list):
        return [_attributes(part) for part in cast("list[Any]", value)]
    return value


async def _computed(name: str, size: int, work: Callable[..., T], *args: Any) -> T:
    """Return the result of `work`. An error in a message that the program made becomes `BadInput`."""
    try:
        return await aside(size, work, *args)
    except BadData as error:
        raise BadInput(f"robot.{name}: {error.message}", error.hint) from error
    except (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, struct.error) as error:
        raise BadInput(f"robot.{name}: the message is not what its type says: {error}.") from error


def _whole(name: str, value: Any, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise BadInput(f"{name} is {value!r}"[:100] + f": give a whole number from {least} to {most}.")
