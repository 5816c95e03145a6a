"""Convert messages that are pictures to PNG or JPEG: which function draws which type, and as which kinds.

A new kind of picture is a function in a file of its own, which takes the message and the bounds and returns a `Raster`,
and one line in `MAKERS`. Pictures with further results (`bird_eye`, `plot`) have their operation in `ops`; all of them
share the final step in `raster`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ros2_mcp.model.errors import BadValue
from ros2_mcp.model.pictures import BOUNDS, COMPRESSED_IMAGE, IMAGE, OCCUPANCY_GRID, Bounds, Picture
from ros2_mcp.pictures.images import compressed_raster, image_raster
from ros2_mcp.pictures.maps import map_raster
from ros2_mcp.pictures.raster import Raster, finished

MAKERS: Mapping[tuple[str, str], Callable[[Any, Bounds], Raster | Picture]] = {
    (IMAGE, "image"): image_raster,
    (COMPRESSED_IMAGE, "image"): compressed_raster,
    (OCCUPANCY_GRID, "map"): map_raster,
}
"""Functions that draw a message, by its type and the kind of picture; a type's first kind is the default."""


def picture_of(type_name: str, message: Any, kind: str = "", bounds: Bounds = BOUNDS) -> Picture:
    """Draw the picture in a message, within the bounds.

    Raises:
        BadData: if the message is not a valid picture, with what is wrong.
        BadValue: for a type that is not a picture, or cannot be drawn as that kind.
    """
    kinds = [known for name, known in MAKERS if name == type_name]
    if not kinds:
        types = sorted({name for name, _ in MAKERS})
        raise BadValue("", f"{type_name} is not a picture.", f"Pictures are {', '.join(types)}.")
    if kind and kind not in kinds:
        raise BadValue("", f"{type_name} cannot be drawn as {kind!r}.", f"Choose from: {', '.join(kinds)}.")
    made = MAKERS[type_name, kind or kinds[0]](message, bounds)
    return finished(made, bounds) if isinstance(made, Raster) else made
