"""Whether noise belongs to the surface, the pixel or the projector's ray, for docs/twin.md.

python -m studies.whose_noise rig.yaml depth_0.npy depth_1.npy ...

The scans are of one camera that did not move, over things that did. In each scan the amplitude of
the fine noise is mapped, in units of its mean over a wider neighbourhood. Two scans are then
compared where they show the same surface, where the same pixel shows another surface, and where
the same ray of the projector meets another surface. The amplitude belongs to whatever must stay
the same for the maps to be correlated.
"""

import sys
from itertools import permutations
from pathlib import Path

import numpy as np

from graycast.base.frames import inverse, pixel_grid, transform_points
from graycast.camera.rig_file import load_scanner
from graycast.real.realism import read_scans
from graycast.real.realism.patches import second_difference
from graycast.rig.optics import project, rays

from .noise_on_slopes import known_mean

NEAR_PX, WIDE_PX, MOST = 2.0, 10.0, 3.5  # one sigma of the means; beyond the last it is an edge
KNOWN = 2 / 3  # of the window of a mean
SAME_M, OTHER_M = 2e-3, 15e-3
RAY_PX = 2.0  # of the projector: a ray is as wide as that


def main() -> None:
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    rig = load_scanner(Path(sys.argv[1])).rig
    scans = list(read_scans([Path(name) for name in sys.argv[2:]], K=rig.camera.K))
    depth_m = np.stack([scan.depth_m for scan in scans])
    amplitude = [amplitude_of(z) for z in depth_m]
    ray = rays(rig.camera, pixel_grid(*depth_m.shape[1:]))
    T_proj_cam = inverse(rig.T_cam_proj)
    place = [
        np.rint(project(rig.projector, transform_points(T_proj_cam, ray * z[..., None])) / RAY_PX)
        for z in depth_m
    ]
    told: dict[str, list[tuple[float, int]]] = {}
    for i, j in permutations(range(len(scans)), 2):
        apart_m = np.abs(depth_m[i] - depth_m[j])
        compare(told, "same surface", amplitude[i], amplitude[j], apart_m < SAME_M)
        compare(told, "same pixel, other surface", amplitude[i], amplitude[j], apart_m > OTHER_M)
        there, there_m = on_rays(place[i], place[j], amplitude[i], depth_m[i])
        apart_m = np.abs(there_m - depth_m[j])
        compare(told, "same ray, other surface", there, amplitude[j], apart_m > OTHER_M)
    for name, values in told.items():
        r, pixels = np.array(values).T
        error = r.std(ddof=1) / np.sqrt(len(r))
        print(f"{name:28s} correlation {np.average(r, weights=pixels):.3f} +- {error:.3f}")


def amplitude_of(depth_m: np.ndarray) -> np.ndarray:
    """Mean square of the second differences, over that of a wider neighbourhood, less 1."""
    size = np.abs(np.pad(second_difference(depth_m), 1, constant_values=np.nan))
    size /= known_mean(size, WIDE_PX, least=KNOWN)
    square = np.minimum(size, MOST) ** 2
    near, wide = (known_mean(square, px, least=KNOWN) for px in (NEAR_PX, WIDE_PX))
    return near / wide - 1


def on_rays(
    place: np.ndarray, other: np.ndarray, values: np.ndarray, depth_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A scan's values and depth, for each pixel of another scan, on the ray that this one sees."""
    at = {}
    for key, value, z in zip(place.reshape(-1, 2), values.ravel(), depth_m.ravel(), strict=True):
        if np.isfinite(value):
            at[tuple(key)] = (value, z)
    missing = (np.nan, np.nan)
    found = np.array([at.get(tuple(key), missing) for key in other.reshape(-1, 2)])
    return found[:, 0].reshape(values.shape), found[:, 1].reshape(values.shape)


def compare(
    told: dict[str, list[tuple[float, int]]],
    name: str,
    first: np.ndarray,
    second: np.ndarray,
    where: np.ndarray,
) -> None:
    both = where & np.isfinite(first) & np.isfinite(second)
    if both.sum() > 100:
        r = float(np.corrcoef(first[both], second[both])[0, 1])
        told.setdefault(name, []).append((r, int(both.sum())))


if __name__ == "__main__":
    main()
