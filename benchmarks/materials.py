"""What a scanner's depth is worth on matt, plastic, dark and metal parts: docs/materials.md.

A heap of brackets is rendered once per rig and material, under the patterns of every code that is
asked for. Each code's pictures are taken and measured, and the depth of the parts' pixels is
compared with the true one.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

PARTS, SEED, SAMPLES = 20, 1, 64
WRONG_M, WRONG_SIGMAS = 1e-3, 5.0  # a depth is wrong that is off by more than both
SCANNERS = ("phoxi-s", "phoxi-m", "phoxi-l", "paper")
CODES_OF = "phoxi-m"  # the rig with which all codes are compared
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """Of one depth map: shares of the parts' pixels, and of the decoded ones for `wrong`.

    `error_over_sigma` is the median of |error| / sigma over that of a normal law: 1 where sigma is
    true.
    """

    scanner: str
    code: str
    material: str
    decoded: float
    right: float
    wrong: float
    error_over_sigma: float


def measured(resolution: str, names: tuple[str, ...] = SCANNERS) -> Iterator[Worth]:
    """All rows, scanner by scanner, material by material."""
    from graycast.render import open_renderer

    with open_renderer("mitsuba") as renderer:
        for name in names:
            yield from _of_rig(renderer, name, resolution)


def _of_rig(renderer: Any, name: str, resolution: str) -> Iterator[Worth]:
    from graycast.cell import resolve_cell
    from graycast.config import Config
    from graycast.drop import DropLimits, drop
    from graycast.parts import Material
    from graycast.render import Quality

    words = {"parts": [{"builtin": "metal_workpiece_1"}], "count": PARTS, "rig": name}
    cell = resolve_cell(Config.model_validate(words | {"resolution": resolution}), Path())
    layout = drop(cell.scene, (PARTS,), seed=SEED, limits=DropLimits())
    scanners = _scanners(name, cell.scanner)
    keys, patterns = _patterns(scanners)
    for material, settings in MATERIALS.items():
        parts = (replace(cell.scene.parts[0], material=Material(**settings)),)
        scene = replace(cell.scene, parts=parts)
        quality = Quality(samples=SAMPLES)
        rendering = renderer.render(scene, layout, patterns, quality=quality, seed=SEED)
        for code, scanner in scanners.items():
            own = [keys.index(key) for key in _keys(scanner)]
            light = replace(rendering.radiance, pattern=rendering.radiance.pattern[own])
            depth = _depth(scanner, light)
            figures = worth(depth, rendering.truth.depth_m, rendering.truth.instance >= 0)
            yield Worth(scanner=name, code=code, material=material, **figures)


def _scanners(name: str, scanner: Any) -> dict[str, Any]:
    """The preset, the same without its guards, and one for each other code."""
    from graycast.decode import DecodeSpec, FilterSpec
    from graycast.pattern import CODECS, CodeSpec

    found = {"preset": scanner}
    if name != "paper":
        bare = {"edge_px": None}
        found["without guards"] = replace(
            scanner,
            code=replace(scanner.code, axes=("column",), fine_period_px=None),
            decode=replace(scanner.decode, min_visibility=0.0),
            filters=replace(scanner.filters, **bare),
        )
    if name == CODES_OF:
        for codec in CODECS:
            code = CodeSpec(codec=codec, axes=("column", "row"))
            plain = {"decode": DecodeSpec(), "filters": FilterSpec()}
            found[codec] = replace(scanner, code=code, **plain)
    return found


def _keys(scanner: Any) -> list[tuple[Any, ...]]:
    """What tells each of a scanner's pictures from those of others."""
    code = scanner.light_code()
    return [(frame, code.offset_px, code.stride_px) for frame in code.frames]


def _patterns(scanners: Mapping[str, Any]) -> tuple[list[tuple[Any, ...]], np.ndarray]:
    """Every picture of every scanner once."""
    from graycast.cell import patterns_of

    found: dict[tuple[Any, ...], np.ndarray] = {}
    for scanner in scanners.values():
        found |= dict(zip(_keys(scanner), patterns_of(scanner), strict=True))
    return list(found), np.stack(list(found.values()))


def _depth(scanner: Any, light: Any) -> Any:
    from graycast.scanner import measure, take

    return measure(scanner, take(scanner, light, seed=SEED))[1]


def worth(
    depth: Any, true_m: Float[np.ndarray, "h w"], parts: Bool[np.ndarray, "h w"]
) -> dict[str, float]:
    """The figures of `Worth`."""
    known = parts & np.isfinite(depth.depth_m)
    off_m, sigma_m = np.abs(depth.depth_m - true_m)[known], depth.sigma_m[known]
    wrong = (off_m > WRONG_M) & (off_m > WRONG_SIGMAS * sigma_m)
    total = max(int(parts.sum()), 1)
    return {
        "decoded": len(off_m) / total,
        "right": float((~wrong).sum()) / total,
        "wrong": float(wrong.mean()) if len(wrong) else 0.0,
        "error_over_sigma": float(np.median(off_m / sigma_m)) / 0.6745 if len(wrong) else np.nan,
    }
