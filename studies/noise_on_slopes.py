"""The noise of scans by the slope of a surface, and whether it stands still, for docs/twin.md.

python -m studies.noise_on_slopes rig.yaml depth_0.npy depth_1.npy ...

The scans are of one camera that did not move, over things that did. Second differences of depth are
taken where two scans show the same surface, and sorted by the slope of the surface along x or along
y. The product of both scans is the part that stands still, half of the square of their difference
is the part that is new in every scan. In that difference, which holds no shape, pixels of
neighbouring rows and columns are then compared.
"""

import sys
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from scipy import ndimage

from graycast.base.robust import robust_sigma
from graycast.camera.rig_file import load_scanner
from graycast.real.realism import read_scans
from graycast.real.realism.patches import second_difference

SAME_M = 2e-3
MEAN_PX, DRIFT_PX = 3.0, 4.0  # one sigma of the means that give slopes, and that take drift away
SLOPES, LEVEL = (0.0, 0.1, 0.3, 0.6, 1.0, 2.2), 0.2  # tangents along an axis; at most across it
MOST_MM = 1.5  # what is farther out is an edge
LEAST = 3000  # pixels


def main() -> None:
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    camera = load_scanner(Path(sys.argv[1])).rig.camera
    scans = list(read_scans([Path(name) for name in sys.argv[2:]], K=camera.K))
    pairs = [pair(a.depth_m, b.depth_m, camera.fx_px) for a, b in combinations(scans, 2)]
    print("| slopes along | tangent | pixels | new in every scan [mm] | standing [mm] "
          "| rows share | columns share |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    for axis in ("x", "y"):
        for low, high in pairwise(SLOPES):
            tell(axis, low, high, pairs)


def pair(first_m: np.ndarray, second_m: np.ndarray, focal_px: float) -> dict[str, np.ndarray]:
    """Second differences of both [mm], their difference, and slopes, where they are the same."""
    near = np.abs(first_m - second_m) < SAME_M
    inner = ndimage.binary_erosion(ndimage.binary_closing(near), iterations=4)
    first, second = (1e3 * np.where(inner & near, z, np.nan) for z in (first_m, second_m))
    both = known_mean((first + second) / 2, MEAN_PX)
    down, right = np.gradient(both)
    a, b = (np.pad(second_difference(z), 1, constant_values=np.nan) for z in (first, second))
    far = (np.abs(a) > MOST_MM) | (np.abs(b) > MOST_MM)
    a[far] = b[far] = np.nan
    apart = first - second
    apart -= known_mean(apart, DRIFT_PX)
    apart[np.abs(apart) > 6 * robust_sigma(apart)] = np.nan
    slope = {"x": right * focal_px / both, "y": down * focal_px / both}
    return {"first": a, "second": b, "apart": apart} | slope


def known_mean(values: np.ndarray, sigma_px: float, *, least: float = 1 / 3) -> np.ndarray:
    """A Gaussian mean over what is known; NaN where that is less than a share of the window."""
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), sigma_px)
    total = ndimage.gaussian_filter(np.where(known, values, 0), sigma_px)
    return np.where(weight > least, total / np.maximum(weight, 1e-9), np.nan)


def tell(axis: str, low: float, high: float, pairs: list[dict[str, np.ndarray]]) -> None:
    other = {"x": "y", "y": "x"}[axis]
    new, standing, power, rows, columns = [], [], [], [], []
    for one in pairs:
        at = (np.abs(one[axis]) >= low) & (np.abs(one[axis]) < high) & (np.abs(one[other]) < LEVEL)
        a, b, apart = (np.where(at, one[key], np.nan) for key in ("first", "second", "apart"))
        new.append((a - b).ravel() ** 2 / 2)
        standing.append((a * b).ravel())
        power.append(apart.ravel() ** 2)
        rows.append((apart[1:] * apart[:-1]).ravel())
        columns.append((apart[:, 1:] * apart[:, :-1]).ravel())
    count = int(np.isfinite(np.concatenate(standing)).sum())
    if count < LEAST:
        return
    of_new, of_standing, total, by_rows, by_columns = (
        float(np.nanmean(np.concatenate(v))) for v in (new, standing, power, rows, columns)
    )
    millimetres = f"{of_new**0.5:.3f} | {max(of_standing, 0.0) ** 0.5:.3f}"
    shared = f"{by_rows / total:.3f} | {by_columns / total:.3f}"
    print(f"| {axis} | {low} to {high} | {count} | {millimetres} | {shared} |")


if __name__ == "__main__":
    main()
