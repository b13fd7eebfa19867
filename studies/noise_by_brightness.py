"""The noise of scans by brightness and slope of what they show, for docs/twin.md.

python -m studies.noise_by_brightness rig.yaml depth_0.npy color_0.png depth_1.npy color_1.png ...

Smooth squares of 32 px are sorted by the incidence of the camera's ray and by their median
brightness (sRGB, 0 to 255). Within the white squares that face the camera, pixels are then sorted
by their brightness relative to the square's median. A colour picture may have a whole multiple of
the scan's pixels.
"""

import sys
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np

from graycast.base.frames import pixel_grid
from graycast.base.robust import robust_sigma
from graycast.camera.rig_file import load_scanner
from graycast.real.realism import read_scans
from graycast.real.realism.patches import (
    GROUPS,
    SQUARE_PX,
    cut_squares,
    second_difference,
)
from graycast.rig.optics import rays

WHITE = 110
INCIDENCE_DEG = (0, 16, 32, 60)
BRIGHTNESS = (0, 40, WHITE, 160, 256)
SHARES = (0.3, 0.7, 0.9, 1.1, 1.4)
NOISE, OUTLYING = (GROUPS["noise"].index(name) for name in ("noise_log_mm", "outlying_share"))


def main() -> None:
    if len(sys.argv) < 4 or len(sys.argv) % 2:
        sys.exit(__doc__)
    camera = load_scanner(Path(sys.argv[1])).rig.camera
    scans = list(read_scans([Path(name) for name in sys.argv[2::2]], K=camera.K))
    pictures = sys.argv[3::2]
    grey = [grey_of(p, s.depth_m.shape) for p, s in zip(pictures, scans, strict=True)]
    ray = rays(camera, pixel_grid(*scans[0].depth_m.shape))
    squares = cut_squares(scans).at("smooth")
    features = squares.group("noise")
    told, size, share = [], [], []
    for i, (number, (row, column)) in enumerate(zip(squares.scan, squares.corner_px, strict=True)):
        cut = np.s_[row : row + SQUARE_PX, column : column + SQUARE_PX]
        z_m = scans[number].depth_m[cut]
        incidence_deg = np.degrees(incidence_rad(z_m, ray[cut]))
        light = grey[number][cut]
        middle, sigma_mm = float(np.median(light)), 10 ** features[i, NOISE]
        told.append((incidence_deg, middle, sigma_mm, features[i, OUTLYING]))
        if middle >= WHITE and incidence_deg < INCIDENCE_DEG[1]:
            mixed_mm = 1e3 * second_difference(z_m)
            known = ~np.isnan(mixed_mm)
            size.append(np.abs(mixed_mm[known]) / sigma_mm)
            share.append(light[1:-1, 1:-1][known] / middle)
    print_groups(np.array(told))
    if size:
        print_shares(np.concatenate(size), np.concatenate(share))


def print_groups(told: np.ndarray) -> None:
    """A line for each class of incidence and brightness of squares, the rows of `told`."""
    print("| degrees | brightness | squares | noise, 10 % [mm] | median | 90 % | outlying [%] |")
    print("|---|---|---|---|---|---|---|")
    incidence_deg, light, sigma_mm, outlying = told.T
    for (flat, steep), (low, high) in product(pairwise(INCIDENCE_DEG), pairwise(BRIGHTNESS)):
        at = (flat <= incidence_deg) & (incidence_deg < steep) & (low <= light) & (light < high)
        if at.sum() > 2:
            noise = " | ".join(f"{v:.3f}" for v in np.percentile(sigma_mm[at], (10, 50, 90)))
            share = f"{100 * outlying[at].mean():.2f}"
            print(f"| {flat} to {steep} | {low} to {high} | {at.sum()} | {noise} | {share} |")


def print_shares(size: np.ndarray, share: np.ndarray) -> None:
    """A line for each class of pixels' brightness, as a share of their square's."""
    print("\n| brightness over the square's median | pixels | noise over the square's |")
    print("|---|---|---|")
    for low, high in pairwise(SHARES):
        group = size[(share >= low) & (share < high)]
        if len(group) > 100:
            print(f"| {low} to {high} | {len(group)} | {robust_sigma(group):.2f} |")


def grey_of(name: str, shape: tuple[int, int]) -> np.ndarray:
    picture = cv2.imread(name)
    if picture is None:
        sys.exit(f"{name} is no picture that can be read")
    rows, columns = picture.shape[:2]
    if rows % shape[0] or rows * shape[1] != columns * shape[0]:
        sys.exit(
            f"{name} has {columns} x {rows} pixels, which is no multiple of the scan's "
            f"{shape[1]} x {shape[0]}: give the picture that belongs to the scan"
        )
    return cv2.resize(picture.mean(axis=2), shape[::-1], interpolation=cv2.INTER_AREA)


def incidence_rad(z_m: np.ndarray, ray: np.ndarray) -> float:
    """Between the middle's ray and the normal of the plane through a square."""
    known = ~np.isnan(z_m)
    normal = np.linalg.lstsq(ray[known], 1 / z_m[known], rcond=None)[0]  # n . ray z = 1
    middle = ray[known].mean(axis=0)
    cosine = normal @ middle / np.linalg.norm(normal) / np.linalg.norm(middle)
    return float(np.arccos(min(abs(cosine), 1.0)))


if __name__ == "__main__":
    main()
