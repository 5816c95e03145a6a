"""Clicks on the page's map, where its picture has a certain colour."""

from __future__ import annotations

from support.browser import Page

WALL, FREE = (28, 36, 33), (255, 255, 255)
"""As the map is drawn in light."""


def click_on_map(
    page: Page, colour: tuple[int, int, int], *, within: int | None = None, left: float = 0, top: float = 0
) -> None:
    """Clicks in the middle of the first place of 5 × 5 pixels that has the colour; `left` and `top` are the frame's."""
    page.until(_FIND.replace("COLOUR", str([*colour])), within=within)
    x, y = page.run(_FIND.replace("COLOUR", str([*colour])), within=within)
    page.click(left + x, top + y)


_FIND = """(() => {
  const canvas = document.querySelector("#map canvas"), box = canvas.getBoundingClientRect();
  const { width, height } = canvas, copy = document.createElement("canvas");
  [copy.width, copy.height] = [width, height];
  const pen = copy.getContext("2d", { willReadFrequently: true });
  pen.drawImage(canvas, 0, 0);
  const { data } = pen.getImageData(0, 0, width, height);
  const is = (x, y) => COLOUR.every((part, at) => data[(y * width + x) * 4 + at] === part);
  for (let y = 40; y < height - 40; y++) for (let x = 40; x < width - 40; x++) {
    let all = true;
    for (let dy = -2; dy < 3 && all; dy++) for (let dx = -2; dx < 3 && all; dx++) all = is(x + dx, y + dy);
    if (all) return [box.left + x + 0.5, box.top + y + 0.5];
  }
  return null;
})()"""
