"""Depth lost at the edges of parts, real and simulated, for docs/measurements/rigs.md.

python -m studies.missing_at_edges

The first row is for the five real scans of a PhoXi, with their draft masks. The other rows are for
simulated scans in the same geometry: household parts of many colours in the real bin, scanned with
the preset `like-phoxi-m` and with changes of its settings against mixed pixels. Scans and meshes
are in ../shared/data, which does not belong to the project.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from pycocotools import mask as coco_mask
from scipy.ndimage import binary_erosion

from benchmarks.decoders import with_single_limits
from benchmarks.stages import cell_of
from graycast.base.tables import markdown_table
from graycast.camera.scanner import Scanner, measure, take
from graycast.cell.resolve import patterns_of
from graycast.real.realism import DepthScan
from graycast.real.realism.depth_steps import count_steps
from graycast.rendering import Quality, Rendering, open_renderer
from graycast.world.drop import DropLimits, drop

from .phoxi_twin import DATA, REAL, T_BIN_CAM, painted_part, refuse_without_data, scanner

PARTS = 16
ERODED_PX = 3  # width of the strip along each part's outline that does not count as "inside"
# Changes of the preset's filters and decoder.
CHANGES: Mapping[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "preset: `max_p_wrong` 0.05, `flying_angle_deg` 75": ({}, {}),
    "`max_p_wrong` 1": ({}, {"max_p_wrong": 1.0}),
    "`max_p_wrong` 0.1": ({}, {"max_p_wrong": 0.1}),
    "`max_p_wrong` 0.2": ({}, {"max_p_wrong": 0.2}),
    "`max_p_wrong` 0.02": ({}, {"max_p_wrong": 0.02}),
    "`max_p_wrong` 0.01": ({}, {"max_p_wrong": 0.01}),
    "no `flying_angle_deg`": ({"flying_angle_deg": None}, {}),
    "`flying_angle_deg` 45": ({"flying_angle_deg": 45.0}, {}),
    "`edge_px` 1": ({"edge_px": 1.0}, {}),
}


@dataclass(slots=True)
class Count:
    """Numbers of all pixels, of pixels without depth and with wrong depth, summed over scenes."""

    pixels: int = 0
    missing: int = 0
    wrong: int = 0

    def add(
        self,
        pixels: Bool[np.ndarray, "h w"],
        missing: Bool[np.ndarray, "h w"],
        wrong: Bool[np.ndarray, "h w"],
    ) -> None:
        """Add the pixels of a mask."""
        self.pixels += int(pixels.sum())
        self.missing += int((missing & pixels).sum())
        self.wrong += int((wrong & pixels).sum())


class Row:
    """Counts for whole parts, for their inside and for the whole picture, for one kind of scan."""

    def __init__(self) -> None:
        self.whole, self.inside, self.picture = Count(), Count(), Count()
        self.steps, self.flying = 0, 0

    def add(
        self,
        masks: list[Bool[np.ndarray, "h w"]],
        depth_m: Float[np.ndarray, "h w"],
        wrong: Bool[np.ndarray, "h w"],
    ) -> None:
        """Add a scan with the masks of its parts."""
        missing = np.isnan(depth_m)
        for mask in masks:
            self.whole.add(mask, missing, wrong)
            self.inside.add(binary_erosion(mask, iterations=ERODED_PX), missing, wrong)
        self.picture.add(np.ones_like(missing), missing, wrong)
        K = scanner().rig.camera.K
        steps = count_steps(DepthScan(name="scan", depth_m=depth_m.copy(), K=K))
        self.steps += steps.step_pixels
        self.flying += steps.flying

    def cells(self, *, truth: bool) -> list[str]:
        """Return the figures of the table; those of wrong depth are empty without `truth`."""
        shares = [100 * one.missing / one.pixels for one in (self.whole, self.inside)]
        strip = Count(*(getattr(self.whole, k) - getattr(self.inside, k) for k in Count.__slots__))
        shares.append(100 * strip.missing / strip.pixels)
        wrong = [
            f"{100 * one.wrong / (one.pixels - one.missing):.2f}" if truth else ""
            for one in (self.whole, self.inside, self.picture)
        ]
        flying = f"{100 * self.flying / max(self.steps, 1):.1f}"
        return [*(f"{share:.1f}" for share in shares), *wrong, flying]


HEADINGS = [
    "scans",
    "missing, parts [%]",
    "inside [%]",
    "strip [%]",
    "wrong, parts [%]",
    "inside [%]",
    "picture [%]",
    "flying at steps [%]",
]


def real() -> Row:
    """Return the counts of the real scans."""
    drafts = json.loads((REAL / "instances_draft.json").read_text())
    row = Row()
    for image in drafts["images"]:
        stored = np.load(REAL / f"depth_{image['id']}.npy")[..., 0].astype(np.float32)
        depth_m = np.where(stored > 0, stored, np.float32(np.nan))
        masks = [
            coco_mask.decode(entry["segmentation"])[::2, ::2] > 0
            for entry in drafts["annotations"]
            if entry["image_id"] == image["id"]
        ]
        row.add(masks, depth_m, np.zeros(depth_m.shape, dtype=bool))
    return row


def simulated(scenes: int, samples: int) -> dict[str, Row]:
    """Return the counts for each change of settings; all use the same rendered pictures."""
    known = scanner()
    variants = {
        name: replace(
            known,
            filters=replace(known.filters, **filters),
            decode=replace(known.decode, **decode),
        )
        for name, (filters, decode) in CHANGES.items()
    }
    variants["single limits, as before"] = with_single_limits(known)
    rows = {name: Row() for name in variants}
    for seed, rendering in _renderings(known, scenes, samples):
        capture = take(known, rendering.radiance, seed=seed)
        truth = rendering.truth
        masks = [truth.instance == i for i in range(truth.instance.max() + 1)]
        for name, changed in variants.items():
            depth = measure(changed, capture, path_noise=rendering.radiance.path_noise)[1]
            rows[name].add(masks, depth.depth_m, depth.is_wrong(truth.depth_m))
    return rows


def _renderings(known: Scanner, scenes: int, samples: int) -> Iterator[tuple[int, Rendering]]:
    """Yield seeds and renderings of household parts in the real bin."""
    rng = np.random.default_rng(0)
    files = sorted((DATA / "meshes" / "kit").glob("*.stl"))
    cell = cell_of(
        {
            "parts": [painted_part(file, "m", rng) for file in files],
            "mix": True,
            "bin": {
                "mesh": str(REAL / "bin.obj"),
                "unit": "m",
                "material": {"base_color": [0.02, 0.02, 0.022], "roughness": 0.4},
            },
            "view": {"T_world_cam": [float(value) for row in T_BIN_CAM for value in row]},
            "light": {"environment": {"radiance": [0.05, 0.05, 0.05]}},
        }
    )
    scene = replace(cell.scene, rig=known.rig)
    with open_renderer("mitsuba") as renderer:
        for seed in range(scenes):
            kinds = np.random.default_rng(seed).integers(len(files), size=PARTS)
            counts = tuple(np.bincount(kinds, minlength=len(files)).tolist())
            layout = drop(scene, counts, seed=seed, limits=DropLimits())
            patterns, quality = patterns_of(known), Quality(samples=samples)
            yield seed, renderer.render(scene, layout, patterns, quality=quality, seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=4, help="The number of heaps.")
    parser.add_argument("--samples", type=int, default=16, help="Paths per pixel.")
    arguments = parser.parse_args()
    refuse_without_data()
    rows = simulated(arguments.scenes, arguments.samples)
    cells = [["real", *real().cells(truth=False)]]
    cells += [[name, *row.cells(truth=True)] for name, row in rows.items()]
    print(markdown_table(HEADINGS, cells))


if __name__ == "__main__":
    main()
