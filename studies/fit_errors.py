"""Why the roughness of smooth surfaces comes back too large, for docs/measurements/surfaces.md.

python -m studies.fit_errors out/errors

Each material is fitted to the scan of `studies.known_materials`, and then with one cause of error
removed: without interreflections in the simulation, with the measured light divided by the share
that other surfaces add to it in a render of the fitted scene, and with the true normals.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

import graycast as gc
from benchmarks.reenact import Pictures, staged
from graycast.base.tables import markdown_table
from graycast.camera.decode import Levels, separate
from graycast.cell.resolve import patterns_of
from graycast.real.material import (
    MaterialFit,
    MaterialScan,
    Reflections,
    fit_material,
    open_scan,
    read_masks,
    scale_of,
)
from graycast.real.material.observing import LEAST_COSINE
from graycast.rendering import Quality, open_renderer
from graycast.world.parts import MATERIALS, Material

from .known_materials import GREY, SEED, away_from, configuration

MATT = Material(base_color=(GREY,) * 3, metallic=0.0, roughness=1.0, specular=0.0)
BOUNCES = 6
SURE_RAD = 1e-3  # Standard deviation of a true normal, which the fit must not divide by
EXACT = Levels(offset_dn=0.0, saturation_dn=1e9, floor_dn2=1.0, slope_dn=0.0)
HEADINGS = ["material", "cause removed", "roughness", "fitted [95 %]", "base colour fitted [95 %]"]
Picture = Float[np.ndarray, "h w"]
Mask = Bool[np.ndarray, "h w"]


def scan_of(
    name: str, rig: str, depth: int, folder: Path
) -> tuple[MaterialScan, Mask, Float[np.ndarray, "h w 3"]]:
    """Simulate a scan; return it with the mask of the parts and the true normals."""
    cell = gc.load_cell(configuration(name, rig, depth=depth))
    with gc.open_cell_renderer(cell, device="cpu") as renderer:
        shot = gc.make_scene(cell, 0, seed=SEED, renderer=renderer)
    scene = gc.save_scene(cell, shot, folder / f"{rig}-{name}-{depth}")
    masks = read_masks(sorted((scene / "mask_sl").glob("000000_*.png")))
    return open_scan(scene / "frames"), masks, shot.rendering.truth.normal


def added_share(scan: MaterialScan, parts: Mask, fit: MaterialFit) -> Picture:
    """Render the fitted surface; return its direct light with interreflections over without."""
    pictures = Pictures(scan=scan, frames=np.zeros((1, *parts.shape)))
    regions: Mapping[str, Mask] = {"parts": parts, "rest": ~parts}
    scene, layout = staged(pictures, regions, {"parts": fit.material, "rest": MATT})
    patterns = patterns_of(replace(scan.scanner, code=scan.result.code))
    direct = []
    with open_renderer("mitsuba", device="cpu") as renderer:
        for depth in (BOUNCES, 1):
            quality = Quality(samples=16, depth=depth)
            rendering = renderer.render(scene, layout, patterns, quality=quality, seed=0)
            direct.append(separate(rendering.radiance.pattern, scan.result.code, EXACT)[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(direct[1] > 1e-3 * np.median(direct[1]), direct[0] / direct[1], np.nan)


def without_share(pixels: Reflections, share: Picture) -> Reflections:
    """Return the pixels with their light divided by a share, where it is known."""
    own = share[tuple(pixels.pixel.T)]
    known = np.flatnonzero(np.isfinite(own) & (own > 0.3))
    pixels, own = pixels.part(known), own[known]
    return replace(pixels, light=pixels.light / own, sigma=pixels.sigma / own)


def with_normals(pixels: Reflections, normal: Float[np.ndarray, "h w 3"]) -> Reflections:
    """Return the pixels with other normals, which count as exact."""
    own = normal[tuple(pixels.pixel.T)].astype(np.float64)
    sigma_rad = np.full(len(own), SURE_RAD)
    pixels = replace(pixels, normal=own, normal_sigma_rad=sigma_rad)
    facing = np.minimum(pixels.light_cosine, (own * pixels.to_camera).sum(axis=-1))
    return pixels.part(np.flatnonzero(facing > LEAST_COSINE))  # NaN compares as False.


def error_over_sigma(pixels: Reflections, normal: Float[np.ndarray, "h w 3"]) -> float:
    """Return the size of the normals' errors over their stated standard deviation.

    The squared angle over sigma squared of two independent axes has the median 2 ln 2.
    """
    cosine = (pixels.normal * normal[tuple(pixels.pixel.T)]).sum(axis=-1)
    angle_rad = np.arccos(np.clip(cosine[np.isfinite(cosine)], -1, 1))
    ratio = angle_rad / pixels.normal_sigma_rad[np.isfinite(cosine)]
    return float(np.sqrt(np.median(ratio**2) / (2 * np.log(2))))


def rows_of(name: str, rig: str, folder: Path) -> list[list[str]]:
    """Fit one material with each cause of error removed in turn."""
    scan, parts, normal = scan_of(name, rig, 4, folder)
    pixels, white = scan.observations(parts), scan.observations(away_from(parts))
    scale = scale_of(white, GREY)
    first = fit_material(pixels, scale=scale, seed=0)
    share = added_share(scan, parts, first)
    corrected = fit_material(
        without_share(pixels, share),
        scale=scale_of(without_share(white, share), GREY),
        seed=0,
    )
    lone, lone_parts, _ = scan_of(name, rig, 1, folder)
    lone_scale = scale_of(lone.observations(away_from(lone_parts)), GREY)
    fits = {
        "none": first,
        "rendered indirect share": corrected,
        "interreflections": fit_material(lone.observations(lone_parts), scale=lone_scale, seed=0),
        "errors of normals": fit_material(with_normals(pixels, normal), scale=scale, seed=0),
    }
    print(f"{name}: errors of normals over sigma {error_over_sigma(pixels, normal):.2f}")
    true = f"{MATERIALS[name].material.roughness:g}"
    return [
        [name, cause, true]
        + [f"{n.value:.3f} ({n.low:.3f} to {n.high:.3f})" for n in (fit.roughness, fit.color)]
        for cause, fit in fits.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="A folder for the scans.")
    parser.add_argument("--rig", default="like-phoxi-m", help="The preset of the scanner.")
    parser.add_argument("--materials", nargs="+", default=("pom-white", "copper"), metavar="NAME")
    arguments = parser.parse_args()
    rows = [
        row
        for name in arguments.materials
        for row in rows_of(name, arguments.rig, arguments.folder)
    ]
    print(markdown_table(HEADINGS, rows))


if __name__ == "__main__":
    main()
