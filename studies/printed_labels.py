"""Draw the labels of the built-in parts, for docs/how-to/python.md. All brands are invented.

python -m studies.printed_labels

This writes the pictures of `src/graycast/world/parts/labels` again, with the place of each panel in
`panels.json`. Each panel is drawn as its reader sees it. Drawing is deterministic, but another
version of the font renderer changes the pixels.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from graycast.world.parts.builtin import SALT_BOX_MM, TOOTHPASTE_MM

Real = float | int
Box = tuple[Real, Real, Real, Real]  # left, top, right and bottom, as shares of a panel
Colour = tuple[int, int, int]  # 8-bit sRGB

_BLEED_PX = 3  # Each panel's border is repeated outwards, so that filtering picks up no neighbour.

SPRAY_WRAP_MM = (177.0, 128.0)  # girth and height of the body, around which the label goes once
LABELS = Path(__file__).resolve().parents[1] / "src/graycast/world/parts/labels"


def pack(
    panels: Mapping[str, UInt8[np.ndarray, "_ _ 3"]], rows: Sequence[Sequence[str]]
) -> tuple[UInt8[np.ndarray, "h w 3"], dict[str, list[int]]]:
    """Pack panels side by side in rows, from top to bottom; unused area stays grey.

    Returns:
        The picture, and the left, top, width and height [px] of each panel in it.
    """
    b = _BLEED_PX
    heights = [max(len(panels[name]) for name in row) + 2 * b for row in rows]
    width = max(sum(panels[name].shape[1] + 2 * b for name in row) for row in rows)
    image = np.full((sum(heights), width, 3), 128, dtype=np.uint8)
    place: dict[str, list[int]] = {}
    for row, top in zip(rows, np.cumsum([0, *heights[:-1]]).tolist(), strict=True):
        left = 0
        for name in row:
            h, w = panels[name].shape[:2]
            bled = np.pad(panels[name], ((b, b), (b, b), (0, 0)), mode="edge")
            image[top : top + h + 2 * b, left : left + w + 2 * b] = bled
            place[name] = [left + b, top + b, w, h]
            left += w + 2 * b
    return image, place


@final
class _Panel:
    """A picture of a given size [mm], drawn at twice its resolution for smooth edges."""

    def __init__(self, width_mm: float, height_mm: float, px_per_mm: float, colour: Colour):
        self.size = (round(width_mm * px_per_mm), round(height_mm * px_per_mm))
        self.image = Image.new("RGB", (2 * self.size[0], 2 * self.size[1]), colour)
        self.draw = ImageDraw.Draw(self.image)

    def _px(self, box: Box) -> Box:
        w, h = self.image.size
        return box[0] * w, box[1] * h, box[2] * w - 1, box[3] * h - 1

    def fill(self, box: Box, colour: Colour) -> None:
        self.draw.rectangle(self._px(box), fill=colour)

    def round(self, box: Box, colour: Colour, radius: float) -> None:
        """Draw a rectangle whose corners have a radius in units of the panel's height."""
        self.draw.rounded_rectangle(self._px(box), radius * self.image.size[1], fill=colour)

    def ellipse(self, box: Box, colour: Colour) -> None:
        self.draw.ellipse(self._px(box), fill=colour)

    def shape(self, points: Sequence[tuple[Real, Real]], colour: Colour) -> None:
        w, h = self.image.size
        self.draw.polygon([(x * w, y * h) for x, y in points], fill=colour)

    def text(self, box: Box, text: str, colour: Colour, face: str = "Sans-Bold") -> None:
        """Draw text in the centre of a box, as large as fits."""
        left, top, right, bottom = self._px(box)
        probe = _font(face, 100.0).getbbox(text)
        wide, high = probe[2] - probe[0], probe[3] - probe[1]
        size = 100 * min((right - left) / wide, (bottom - top) / high)
        font = _font(face, size)
        x0, y0, x1, y1 = font.getbbox(text)
        at = ((left + right - x0 - x1) / 2, (top + bottom - y0 - y1) / 2)
        self.draw.text(at, text, fill=colour, font=font)

    def lines(self, box: Box, lines: Sequence[str], colour: Colour, face: str = "Sans") -> None:
        """Draw small text: left-aligned lines of one size that fill a box from the top."""
        left, top, right, bottom = self._px(box)
        probe = _font(face, 100.0)
        widest = max(probe.getlength(line) for line in lines)
        size = min(100 * (right - left) / widest, (bottom - top) / len(lines) / 1.35)
        for k, line in enumerate(lines):
            at = (left, top + 1.35 * size * k)
            self.draw.text(at, line, fill=colour, font=_font(face, size))

    def barcode(self, box: Box, seed: int) -> None:
        """Draw a bar code without meaning: black bars of random width on white, and digits."""
        rng = np.random.default_rng(seed)
        x0, y0, x1, y1 = box
        self.fill(box, (255, 255, 255))
        edge = np.cumsum(rng.integers(1, 4, size=58))
        edge = x0 + (x1 - x0) * (0.06 + 0.88 * edge / edge[-1])
        for left, right in zip(edge[0::2], edge[1::2], strict=True):
            self.fill((left, y0 + 0.06 * (y1 - y0), right, y0 + 0.78 * (y1 - y0)), (15, 15, 15))
        digits = "".join(str(d) for d in rng.integers(0, 10, size=13))
        self.text((x0 + 0.1 * (x1 - x0), y0 + 0.82 * (y1 - y0), x1 - 0.1 * (x1 - x0),
                   y1 - 0.04 * (y1 - y0)), digits, (15, 15, 15), "SansMono")  # fmt: skip

    def pixels(self) -> UInt8[np.ndarray, "h w 3"]:
        return np.array(self.image.resize(self.size, Image.Resampling.BOX))


def _font(face: str, size: float) -> ImageFont.FreeTypeFont:
    """Return a face of the DejaVu family, which Matplotlib ships."""
    from matplotlib import get_data_path

    file = Path(get_data_path(), "fonts", "ttf", f"DejaVu{face}.ttf")
    return ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)


def salt_box_panels() -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """Return the six panels of the yellow salt box."""
    yellow, blue, white, red = (250, 205, 20), (20, 60, 140), (250, 248, 240), (205, 35, 40)
    x_mm, y_mm, z_mm = SALT_BOX_MM

    def blank(width_mm: float, height_mm: float) -> _Panel:
        return _Panel(width_mm, height_mm, 4.0, yellow)

    def face(claim: str) -> _Panel:
        p = blank(x_mm, z_mm)
        p.fill((0, 0, 1, 0.05), blue)
        p.fill((0, 0.88, 1, 1), blue)
        p.ellipse((0.06, 0.09, 0.94, 0.42), blue)
        p.ellipse((0.09, 0.104, 0.91, 0.406), white)
        p.text((0.15, 0.16, 0.85, 0.235), "Brinewell", blue, "Serif-BoldItalic")
        p.text((0.24, 0.27, 0.76, 0.345), "SALT", red)
        p.text((0.1, 0.46, 0.9, 0.505), claim, blue)
        p.text((0.1, 0.905, 0.9, 0.965), "650 g", white)
        return p

    front = face("FINE TABLE SALT")
    front.shape([(0.2, 0.83), (0.42, 0.57), (0.5, 0.64), (0.6, 0.54), (0.82, 0.83)], white)
    front.shape([(0.2, 0.83), (0.42, 0.57), (0.45, 0.66), (0.36, 0.83)], (205, 220, 235))
    front.shape([(0.6, 0.54), (0.82, 0.83), (0.62, 0.83), (0.57, 0.68)], (205, 220, 235))
    back = face("FOR COOKING & BAKING")
    story = ["Evaporated from deep brine,", "dried gently and sieved fine.", "",
             "Store in a dry place. Close", "the spout after use. Best",
             "before: see the top."]  # fmt: skip
    back.lines((0.09, 0.55, 0.91, 0.85), story, (40, 35, 20))
    right = blank(y_mm, z_mm)
    right.fill((0, 0, 1, 0.05), blue)
    right.fill((0, 0.88, 1, 1), blue)
    right.text((0.12, 0.09, 0.88, 0.13), "NUTRITION per 100 g", blue)
    table = ["Energy         0 kJ", "Fat            0 g", "Carbohydrate   0 g",
             "Protein        0 g", "Salt          99 g", "Iodine         2 mg"]  # fmt: skip
    right.round((0.08, 0.15, 0.92, 0.4), white, 0.015)
    right.lines((0.13, 0.175, 0.87, 0.4), table, (30, 30, 30), "SansMono")
    right.text((0.1, 0.56, 0.9, 0.62), "Brinewell", blue, "Serif-BoldItalic")
    right.text((0.12, 0.68, 0.88, 0.82), "650 g", red)
    left = blank(y_mm, z_mm)
    left.fill((0, 0, 1, 0.05), blue)
    left.fill((0, 0.88, 1, 1), blue)
    left.text((0.1, 0.1, 0.9, 0.16), "Brinewell", blue, "Serif-BoldItalic")
    words = ["Ingredients: salt, potassium", "iodate, anticaking agent.", "",
             "Packed by Brinewell Saltworks,", "1 Harbour Row, Nowhere."]  # fmt: skip
    left.lines((0.08, 0.22, 0.92, 0.44), words, (40, 35, 20))
    left.barcode((0.1, 0.58, 0.9, 0.82), seed=1)
    top = blank(x_mm, y_mm)
    top.round((0.3, 0.2, 0.7, 0.55), (225, 225, 220), 0.05)
    top.round((0.33, 0.23, 0.67, 0.52), (200, 200, 195), 0.04)
    top.text((0.37, 0.32, 0.63, 0.43), "POUR", blue)
    top.text((0.12, 0.72, 0.88, 0.86), "BEST BEFORE 11.2029", (40, 35, 20), "SansMono")
    bottom = blank(x_mm, y_mm)
    bottom.fill((0, 0.49, 1, 0.51), (215, 170, 10))
    bottom.text((0.2, 0.62, 0.8, 0.74), "LOT 4711-B", (40, 35, 20), "SansMono")
    panels = {"front": front, "right": right, "back": back, "left": left}
    panels |= {"top": top, "bottom": bottom}
    return {name: panel.pixels() for name, panel in panels.items()}


def toothpaste_panels() -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """Return the six panels of the toothpaste carton, which lies with its long side along x."""
    white, teal, red, mint = (248, 250, 250), (0, 110, 140), (215, 30, 55), (150, 220, 205)
    x_mm, y_mm, z_mm = TOOTHPASTE_MM

    def blank(width_mm: float, height_mm: float, colour: Colour = white) -> _Panel:
        return _Panel(width_mm, height_mm, 4.5, colour)

    def banner(height_mm: float) -> _Panel:
        p = blank(x_mm, height_mm)
        p.fill((0, 0, 0.16, 1), teal)
        p.shape([(0.16, 0), (0.24, 0), (0.16, 1)], teal)
        p.shape([(0.24, 0), (0.29, 0), (0.21, 1), (0.16, 1)], mint)
        p.fill((0, 0.93, 1, 1), red)
        return p

    front = banner(z_mm)
    front.text((0.31, 0.12, 0.8, 0.6), "Dentuva", red, "Sans-BoldOblique")
    front.text((0.31, 0.66, 0.8, 0.84), "COOL MINT TOOTHPASTE", teal)
    front.ellipse((0.845, 0.14, 0.975, 0.82), mint)
    front.text((0.865, 0.3, 0.955, 0.48), "24 h", teal)
    front.text((0.862, 0.52, 0.958, 0.64), "FRESH", teal)
    front.text((0.03, 0.2, 0.15, 0.46), "100", white)
    front.text((0.05, 0.55, 0.13, 0.75), "ml", white)
    back = banner(z_mm)
    directions = ["Brush thoroughly after meals, at least twice a day. Do not swallow.",
                  "Children under six: use an amount the size of a pea, with help.",
                  "Ingredients: aqua, sorbitol, hydrated silica, glycerin, xylitol,",
                  "aroma, cellulose gum, sodium fluoride (1450 ppm F), menthol."]  # fmt: skip
    back.lines((0.31, 0.14, 0.78, 0.88), directions, (40, 60, 70))
    back.barcode((0.8, 0.1, 0.98, 0.86), seed=2)
    back.text((0.02, 0.3, 0.15, 0.6), "Dentuva", white, "Sans-BoldOblique")
    top = banner(y_mm)
    top.text((0.31, 0.15, 0.66, 0.75), "Dentuva", red, "Sans-BoldOblique")
    top.text((0.7, 0.25, 0.96, 0.45), "ENAMEL CARE", teal)
    top.text((0.7, 0.55, 0.96, 0.75), "WITH FLUORIDE", teal)
    bottom = banner(y_mm)
    bottom.text((0.31, 0.2, 0.75, 0.7), "100 ml  COOL MINT", teal)
    bottom.text((0.8, 0.3, 0.97, 0.6), "Dentuva", red, "Sans-BoldOblique")
    ends = {}
    for name, code in (("right", "EXP 2028-07"), ("left", "LOT 0815 K")):
        end = blank(y_mm, z_mm, teal)
        end.text((0.12, 0.2, 0.88, 0.5), "Dentuva", white, "Sans-BoldOblique")
        end.text((0.15, 0.65, 0.85, 0.8), code, mint, "SansMono")
        ends[name] = end
    panels = {"front": front, "back": back, "top": top, "bottom": bottom, **ends}
    return {name: panel.pixels() for name, panel in panels.items()}


def spray_panels() -> dict[str, UInt8[np.ndarray, "_ _ 3"]]:
    """Return the wrap of the spray bottle (its middle is the front) and samples of its plastics."""
    plastic, green, dark, white = (240, 242, 240), (60, 170, 90), (15, 80, 60), (252, 252, 252)
    p = _Panel(*SPRAY_WRAP_MM, 5.8, plastic)
    p.fill((0, 0.2, 1, 0.88), white)
    p.fill((0, 0.2, 1, 0.235), green)
    p.fill((0, 0.72, 1, 0.88), dark)
    p.shape([(0, 0.72), (0.25, 0.64), (0.5, 0.7), (0.75, 0.63), (1, 0.72)], green)
    p.text((0.37, 0.28, 0.63, 0.38), "Zephin", dark, "Sans-BoldOblique")
    p.text((0.38, 0.42, 0.62, 0.46), "HYGIENE SPRAY", green)
    p.text((0.4, 0.495, 0.6, 0.525), "surfaces & hands", dark, "Sans")
    for x, y, r in ((0.44, 0.6, 0.02), (0.5, 0.58, 0.026), (0.56, 0.6, 0.02)):
        p.ellipse((x - r, y - 1.3 * r, x + r, y + 1.3 * r), green)
        p.ellipse((x - 0.5 * r, y - 1.0 * r, x, y - 0.2 * r), white)
    p.text((0.39, 0.76, 0.61, 0.83), "250 ml", white)
    words = ["Spray from 20 cm onto dry", "surfaces and let it work for", "30 seconds. No rinsing.",
             "Contains: ethanol, aqua,", "glycerin, parfum.", "Highly flammable."]  # fmt: skip
    p.lines((0.73, 0.27, 0.97, 0.56), words, dark)
    p.barcode((0.04, 0.28, 0.24, 0.52), seed=3)
    p.text((0.04, 0.77, 0.24, 0.82), "Zephin", white, "Sans-BoldOblique")
    p.text((0.76, 0.77, 0.96, 0.82), "IN 30 SECONDS", white)
    swatch = np.zeros((24, 120, 3), dtype=np.uint8)
    return {
        "body": p.pixels(),
        "head": swatch + np.array([25, 130, 75], dtype=np.uint8),
        "trigger": swatch + np.array([235, 235, 230], dtype=np.uint8),
    }


LAYOUTS = {
    "salt_box": (salt_box_panels, (("front", "right", "back", "left"), ("top", "bottom"))),
    "toothpaste": (
        toothpaste_panels,
        (("front", "right"), ("back", "left"), ("top",), ("bottom",)),
    ),
    "spray": (spray_panels, (("body",), ("head", "trigger"))),
}


def main() -> None:
    places = {}
    for name, (draw, rows) in LAYOUTS.items():
        image, places[name] = pack(draw(), rows)
        Image.fromarray(image).save(LABELS / f"{name}.png", optimize=True)
    (LABELS / "panels.json").write_text(json.dumps(places) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
