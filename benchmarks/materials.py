"""Depth on matt, plastic, dark and metal parts, for docs/measurements/materials.md.

A heap of brackets is rendered once per rig and material, with the patterns of all compared codes.
For each code, a scan is simulated, and its depth on parts is compared with the true depth.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

from graycast.base.tables import markdown_table
from graycast.camera.decode import DecodeSpec, DepthMap, FilterSpec
from graycast.camera.scanner import Scanner, measure
from graycast.rendering import Quality, Renderer, open_renderer
from graycast.rig.pattern import CODECS, CodeSpec
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material

from .decoders import pictures_of, shared_patterns
from .stages import cell_of

PARTS, SEED, SAMPLES = 20, 2, 64  # Seed 1 was used to choose the settings of scanners.
SCANNERS = ("like-phoxi-s", "like-phoxi-m", "like-phoxi-l", "paper")
PRESET, BARE = "preset", "without a limit"
EXPOSURES = {"one exposure": (1.0,), "three exposures": (0.25, 1.0, 4.0)}
PARTS_PLACE, AROUND_PLACE, AROUND_PX = "parts", "around", 20
CODES_OF = "like-phoxi-m"  # the rig with which all codes are compared
METAL = {"base_color": (0.7, 0.7, 0.7), "metallic": 1.0}
MATERIALS: Mapping[str, dict[str, Any]] = {
    "matt": {"base_color": (0.5, 0.5, 0.5), "specular": 0.0},
    "plastic": {"base_color": (0.6, 0.6, 0.6), "roughness": 0.35},
    "dark": {"base_color": (0.03, 0.03, 0.03), "roughness": 0.6},
    "steel": {"base_color": (0.22, 0.22, 0.225), "metallic": 1.0, "roughness": 0.5},
    "metal 0.5": METAL | {"roughness": 0.5},
    "metal 0.35": METAL | {"roughness": 0.35},
    "metal 0.2": METAL | {"roughness": 0.2},
    "metal 0.1": METAL | {"roughness": 0.1},
}

INTRODUCTION = """\
`python -m benchmarks materials --resolution {resolution}` wrote this page on {date:.10} at commit
`{commit}` on {cores} processors ({cpu}).

Twenty brackets lie in a bin at each scanner's default distance, rendered with 64 paths per pixel.
A cell has three figures for the parts' pixels: the share with depth [%]; the share of this depth
[%] that is *wrong*, off by more than 1 mm *and* five of its own sigmas; and the median error over
sigma (1 where sigma is true). The number after *metal* is the roughness. The reflectance is 0.7
for metal and 0.22 for *steel*.

The presets remove depth whose [probability](wrong_depth.md) to be wrong is above 0.05
(`max_p_wrong`), and flying pixels. *Without a limit*, they keep both. `paper` has plain Gray code,
no limit and no filter. The probabilities were fitted to scenes with other parts.

**Conclusion.** Without a limit, up to {bare:.1f} % of the depths are wrong. With it, at most
{limited}. On metal, the limit keeps {least:.0f} to {most:.0f} % of the right
depths."""

EXPOSED = """\
`{scanner}` with the exposure that the white frame asks for, or with 0.25, 1 and 4 times it.

"""
AROUND = """\
Bin pixels within {pixels} pixels of a part. Parts shade them, and metal reflects the projector's
light onto them, so that some see light from two columns.

"""
CODES = """\
The rig of `{scanner}` with each code on both axes, the default `decode` and no filter. On the
smoothest metal `{best.code}` has the fewest wrong depths, {best_wrong:.1f} %, and `{worst.code}`
the most, {worst_wrong:.1f} %.

"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """Shares of the pixels of a place in one depth map; `wrong` is a share of the decoded pixels.

    `error_over_sigma` is the median of |error| / sigma, divided by the median of a normal
    distribution. It is 1 if sigma is right.
    """

    scanner: str
    code: str
    material: str
    place: str
    decoded: float
    right: float
    wrong: float
    error_over_sigma: float

    @property
    def words(self) -> str:
        shares = f"{100 * self.decoded:.0f}; {100 * self.wrong:.1f}"
        return f"{shares}; {self.error_over_sigma:.2f}"


def measured(resolution: str, names: Iterable[str] = SCANNERS) -> Iterator[Worth]:
    """Yield all rows, scanner by scanner and material by material."""
    with open_renderer("mitsuba") as renderer:
        for name in names:
            yield from _of_rig(renderer, name, resolution)


def page(rows: list[Worth], **about: object) -> Iterator[tuple[str, str]]:
    """Yield the headings and texts of docs/measurements/materials.md."""
    bare, limited = (_most_wrong(rows, code) for code in (BARE, PRESET))
    metal = _metal_shares(rows)
    shares = {"least": 100 * min(metal), "most": 100 * max(metal)}
    each = ", ".join(f"{limited[name]:.1f} % (`{name}`)" for name in bare)
    text = INTRODUCTION.format(bare=max(bare.values()), limited=each, **shares, **about)
    yield "Depth on matt, plastic, dark and metal parts", text
    columns = {
        (row.scanner, row.code): row.scanner if row.code == PRESET else row.code for row in rows
    }
    presets = {key: head for key, head in columns.items() if key[1] in (PRESET, BARE)}
    exposed = {key: head for key, head in columns.items() if key[1] in EXPOSURES}
    codes = {key: head for key, head in columns.items() if key[1] in CODECS}
    yield "Presets", _table(rows, presets)
    if codes:
        smoothest = [
            row
            for row in rows
            if (row.material, row.place) == (list(MATERIALS)[-1], PARTS_PLACE)
            and (row.scanner, row.code) in codes
        ]
        best, worst = (choose(smoothest, key=lambda row: row.wrong) for choose in (min, max))
        wrong = {"best_wrong": 100 * best.wrong, "worst_wrong": 100 * worst.wrong}
        text = CODES.format(scanner=CODES_OF, best=best, worst=worst, **wrong)
        yield "Codes", text + _table(rows, codes)
    if exposed:
        yield "Exposures", EXPOSED.format(scanner=CODES_OF) + _table(rows, exposed)
    if beside := [row for row in rows if row.place == AROUND_PLACE]:
        near = {key: head for key, head in presets.items() if key[0] in (CODES_OF, "paper")}
        text = AROUND.format(pixels=AROUND_PX)
        yield "Around the parts", text + _table(beside, near, AROUND_PLACE)


def _most_wrong(rows: list[Worth], code: str) -> dict[str, float]:
    """Return the largest share of wrong depths on parts [%] of each scanner with a code."""
    most: dict[str, float] = {}
    for row in rows:
        if row.code == code and row.place == PARTS_PLACE:
            most[row.scanner] = max(100 * row.wrong, most.get(row.scanner, 0.0))
    return most


def _metal_shares(rows: list[Worth]) -> list[float]:
    """Return the shares of the right depths on metal that the presets keep with their limit."""
    right = {
        (row.scanner, row.code, row.material): row.right
        for row in rows
        if row.place == PARTS_PLACE and row.material.startswith("metal")
    }
    return [
        right[scanner, PRESET, material] / everything
        for (scanner, code, material), everything in right.items()
        if code == BARE
    ]


def _table(
    rows: list[Worth], columns: Mapping[tuple[str, str], str], place: str = PARTS_PLACE
) -> str:
    by_key = {(row.scanner, row.code, row.material): row for row in rows if row.place == place}
    rows_of = [[each, *(by_key[*column, each].words for column in columns)] for each in MATERIALS]
    return markdown_table(["decoded; wrong; error/sigma", *columns.values()], rows_of)


def _of_rig(renderer: Renderer, name: str, resolution: str) -> Iterator[Worth]:
    cell = cell_of({"count": PARTS, "rig": name, "resolution": resolution})
    layout = drop(cell.scene, (PARTS,), seed=SEED, limits=DropLimits())
    scanners = _scanners(name, cell.scanner)
    keys, patterns = shared_patterns([*scanners.values()])
    for material, settings in MATERIALS.items():
        parts = (replace(cell.scene.parts[0], material=Material(**settings)),)
        scene = replace(cell.scene, parts=parts)
        quality = Quality(samples=SAMPLES)
        rendering = renderer.render(scene, layout, patterns, quality=quality, seed=SEED)
        for code, scanner in scanners.items():
            capture, light = pictures_of(scanner, rendering.radiance, keys, seed=SEED)
            depth = measure(scanner, capture, path_noise=light.path_noise)[1]
            own_pixels = rendering.truth.instance >= 0
            for place, pixels in ((PARTS_PLACE, own_pixels), (AROUND_PLACE, around(own_pixels))):
                figures = worth(depth, rendering.truth.depth_m, pixels)
                yield Worth(scanner=name, code=code, material=material, place=place, **figures)


def around(parts: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels near parts that do not show a part."""
    square = np.ones((2 * AROUND_PX + 1,) * 2, np.uint8)
    near = np.asarray(cv2.dilate(parts.astype(np.uint8), square)) > 0
    return near & ~parts


def _scanners(name: str, scanner: Scanner) -> dict[str, Scanner]:
    """Return the preset, and variants without a limit or with other exposures or codes."""
    scanners = {PRESET: scanner}
    if name != "paper":
        scanners[BARE] = replace(
            scanner,
            decode=replace(scanner.decode, max_p_wrong=1.0),
            filters=replace(scanner.filters, flying_angle_deg=None),
        )
    if name == CODES_OF:
        for words, factors in EXPOSURES.items():
            scanners[words] = replace(scanner, exposure=replace(scanner.exposure, factors=factors))
        for codec in CODECS:
            code = CodeSpec(codec=codec, axes=("column", "row"))
            scanners[codec] = replace(scanner, code=code, decode=DecodeSpec(), filters=FilterSpec())
    return scanners


def worth(
    depth: DepthMap, true_m: Float[np.ndarray, "h w"], pixels: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """Return the numeric fields of `Worth` for the given pixels of a depth map."""
    known = pixels & np.isfinite(depth.depth_m)
    off_m, sigma_m = np.abs(depth.depth_m - true_m)[known], depth.sigma_m[known]
    wrong = depth.is_wrong(true_m)[known]
    total = max(int(pixels.sum()), 1)
    return {
        "decoded": len(off_m) / total,
        "right": float((~wrong).sum()) / total,
        "wrong": float(wrong.mean()) if len(wrong) else 0.0,
        "error_over_sigma": float(np.median(off_m / sigma_m)) / 0.6745 if len(wrong) else np.nan,
    }
