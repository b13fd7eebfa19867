"""The colour pictures of five real scans, and the light in them: docs/measurements/reenactment.md.

python -m studies.phoxi_pictures

The first table states where the pictures are black, and how bright the bin is. For the second one,
a material of the bin is fitted to scans 0 to 2 as though the scanner's projector were the only
light, and predicts the bin's pixels in scans 3 and 4. Two other guesses of the light show how much
the first one explains: light at the camera, and equal light on all pixels.

The scans are in ../shared/data, which is no part of the project.
"""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import spearmanr

from graycast.base.errors import GraycastError
from graycast.base.tables import markdown_table
from graycast.real.material import Reflections, fit_material, observe_picture
from graycast.real.material.surface_model import mean_light
from graycast.rig.pair import Rig

from .phoxi_twin import REAL, refuse_without_data, scanner

CHANNELS = ("red", "green", "blue")
FITTED, PREDICTED = (0, 1, 2), (3, 4)
APART_PX = 4  # Pixels of the bin keep this distance from the parts, whose light reaches them.
PERCENTILES = (1, 10, 25, 75, 90, 99)
EVIDENCE_HEADINGS = [
    "scan", "black where depth is missing", "black where it is not", "bin: red", "green", "blue",
]  # fmt: skip
HEADINGS = ["channel", "light", "fitted", "median error", "rank correlation", "percentiles"]


@dataclass(frozen=True, kw_only=True)
class ColorScan:
    """A scan on the grid of its depth."""

    depth_m: Float[np.ndarray, "h w"]
    stored: Float[np.ndarray, "h w 3"]  # The stored numbers of RGB, from 0 to 1
    parts: Bool[np.ndarray, "h w"]

    @property
    def black(self) -> Bool[np.ndarray, "h w"]:
        return self.stored.max(axis=-1) == 0

    @property
    def bin(self) -> Bool[np.ndarray, "h w"]:
        """The pixels of the bin and of what is around it that have depth and colour."""
        disc = np.ones((2 * APART_PX + 1,) * 2, dtype=np.uint8)
        near = cv2.dilate(self.parts.astype(np.uint8), disc) > 0
        return np.isfinite(self.depth_m) & ~near & ~self.black


def linear(stored: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the light of stored numbers from 0 to 1 under the transfer function of sRGB."""
    return np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)


def read_scan(number: int) -> ColorScan:
    """Read a scan. Its depth has the odd pixels of the picture, where black fits depth best."""
    depth_m = np.load(REAL / f"depth_{number}.npy")[..., 0].astype(np.float64)
    color = cv2.cvtColor(cv2.imread(str(REAL / f"color_{number}.png")), cv2.COLOR_BGR2RGB)
    parts = cv2.imread(str(REAL / f"segmask_{number}.png"), cv2.IMREAD_GRAYSCALE) > 0
    if parts.shape != depth_m.shape:
        parts = parts[1::2, 1::2]
    return ColorScan(
        depth_m=np.where(depth_m > 0, depth_m, np.nan),
        stored=color[1::2, 1::2] / 255,
        parts=parts,
    )


def evidence(number: int, scan: ColorScan) -> list[str]:
    """Return where a picture is black, and the median of the bin in each channel."""
    missing = np.isnan(scan.depth_m)
    shares = [f"{scan.black[where].mean():.1%}" for where in (missing, ~missing)]
    medians = np.median(linear(scan.stored[scan.bin]), axis=0)
    return [f"{number}", *shares, *(f"{value:.4f}" for value in medians)]


def observed(rig: Rig, scans: Sequence[ColorScan], channel: int, inside: str) -> Reflections:
    """Return the pixels of several scans as though the rig's projector had lit their pictures."""
    parts = []
    for scan in scans:
        stored = scan.stored[..., channel]
        # One stored step is taken as the standard deviation of the noise.
        noise = linear(stored + 0.5 / 255) - linear(np.maximum(stored - 0.5 / 255, 0))
        parts.append(
            observe_picture(
                rig,
                scan.depth_m,
                linear(stored),
                noise,
                inside=getattr(scan, inside) & ~scan.black & np.isfinite(scan.depth_m),
                clipped=stored == 1,
            )
        )
    names = [field.name for field in fields(Reflections) if field.default is MISSING]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return Reflections(**joined)


def prediction(true: Float[np.ndarray, " n"], own: Float[np.ndarray, " n"]) -> list[str]:
    """Return the median relative error, the rank correlation, and percentiles over the median."""
    rank = float(spearmanr(true, own).statistic) if np.ptp(own) > 0 else float("nan")
    spans = [
        " ".join(f"{value:.2f}" for value in np.percentile(one, PERCENTILES) / np.median(one))
        for one in (true, own)
    ]
    error = float(np.median(np.abs(own - true) / true))
    return [f"{error:.0%}", "-" if np.isnan(rank) else f"{rank:.2f}", " / ".join(spans)]


def rows_of(channel: int, scans: Sequence[ColorScan], inside: str = "bin") -> list[list[str]]:
    """Fit a material to some scans and predict the light of others, for each guess of the light."""
    rig = scanner().rig
    near_camera_m = np.array([0.0, 0.001, 0.0])  # A rig must have a baseline.
    at_camera = replace(rig, T_cam_proj=_moved(rig.T_cam_proj, near_camera_m))
    rows = []
    for light, own in (("projector", rig), ("at the camera", at_camera)):
        train, test = (
            observed(own, [scans[k] for k in numbers], channel, inside)
            for numbers in (FITTED, PREDICTED)
        )
        try:
            fit = fit_material(train, seed=0)
        except GraycastError as error:
            rows.append([CHANNELS[channel], light, str(error).partition(":")[0], "", "", ""])
            continue
        factor = np.median(train.light) / np.median(mean_light(train, fit.material))
        words = f"roughness {fit.roughness.value:.2f}, scatter {fit.scatter:.0%}"
        predicted = factor * mean_light(test, fit.material)
        rows.append([CHANNELS[channel], light, words, *prediction(test.light, predicted)])
    light_values = [
        np.concatenate([linear(scans[k].stored[..., channel][scans[k].bin]) for k in numbers])
        for numbers in (FITTED, PREDICTED)
    ]
    bright = light_values[1][light_values[1] > 0]
    same = np.full(len(bright), np.median(light_values[0]))
    rows.append([CHANNELS[channel], "equal everywhere", "", *prediction(bright, same)])
    return rows


def _moved(
    T: Float[np.ndarray, "4 4"], place_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "4 4"]:
    own = T.copy()
    own[:3, 3] = place_m
    return own


def main() -> None:
    refuse_without_data()
    scans = [read_scan(number) for number in range(5)]
    table = [evidence(number, scan) for number, scan in enumerate(scans)]
    print(markdown_table(EVIDENCE_HEADINGS, table))
    print()
    rows = [row for channel in range(3) for row in rows_of(channel, scans)]
    print(markdown_table(HEADINGS, rows))
    print("\nAll household parts as one material:\n")
    rows = [row for channel in range(3) for row in rows_of(channel, scans, "parts")[:2]]
    print(markdown_table(HEADINGS, rows))


if __name__ == "__main__":
    main()
