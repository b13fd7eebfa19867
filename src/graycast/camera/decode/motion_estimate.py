"""Estimate a steady motion of the scene from the pictures of a code.

A motion and a depth say where the point of a pixel was in every picture, and which light it then
received. The right motion is the one at which pictures and light correlate best, over pixels all
over the picture, each with its own best depth. The likelihood of a motion has several maxima, so
the search needs a start that is near enough.

Leaves out: motions that turn; pauses between pictures; parts that move on their own.
"""

import math
from itertools import count, pairwise
from typing import NamedTuple

import cv2
import numba
import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize

from ...base import array_types as arrays
from ...base.errors import DecodeError
from ...base.kernels import kernel
from ...base.progress import UNWATCHED, ProgressMeter
from ...rig.optics import picture_rays
from ...rig.pair import Rig
from ...rig.pattern import Code
from .moving_points import (
    at_nearness,
    between,
    displacements,
    light_of_frames,
    nearnesses,
    places,
    share_at,
    value_at,
)

# Pictures and light are blurred alike [px of the camera], because interpolation between pixels
# blurs, too, and would make motions by fractions of a pixel look better than others.
BLUR_PX = 1.0
TILES = 20  # Rows and columns of tiles; two pixels of each tile are used.
STEP_PX = 4.0  # Motion of the projector's place between two depths
FINE = 8  # Parts of a step in which the best depth is then searched
MOST_SHARE = 0.99999  # Rounding makes no pixel surer than this (r squared).
RADIUS_PX = 2.4  # First steps of the search, over the whole stack
END_PX = 0.08
TRIALS = 60  # Most motions that are tried from one start
AROUND = (1.0, 0.8, 1.2)  # The search starts at these multiples of the assumed motion,
FARTHEST = 0.4  # and ends at most this share of it away.
REST_PX = 0.5  # If the assumed motion is less over the whole stack, the search starts at rest
BESIDE_PX = 6.0  # and at this motion along x and y.


def steady_motion(
    frames: arrays.UInt8or16Array_n_h_w,
    code: Code,
    rig: Rig,
    time: Float[np.ndarray, " n"],
    *,
    start_m: Float[np.ndarray, "3"],
    progress: ProgressMeter = UNWATCHED,
) -> Float[np.ndarray, "3"]:
    """Return the motion of the scene per unit of time, in the coordinates of the camera [m].

    Args:
        time: the time of each frame, in any unit, such as the number of the picture.
        start_m: an assumed motion per unit of time, which is right within about 20 %. If it is 0,
            the picture must move by less than about 8 px from the first frame to the last. Even
            then, the result can be 0 if large surfaces move within their own plane.

    Raises:
        DecodeError: the numbers of frames and times differ, or no time passes; no point stays in
            the camera's picture.
    """
    if not len(frames) == len(code.frames) == len(time) or np.ptp(time) == 0:
        raise DecodeError(
            f"there are {len(frames)} frames and {len(time)} times, and the code has "
            f"{len(code.frames)} frames: give one frame for each, with different times"
        )
    likelihood = _Likelihood(frames, code, rig)
    unit_m = _pixel_m(rig) / np.ptp(time)  # A motion by one pixel over the whole stack

    def misfit(motion_px: Float[np.ndarray, "3"]) -> float:
        progress.count("trials of the motion", next(trial), most)
        return -likelihood(steady_transforms(motion_px * unit_m, time))

    start_px = start_m / unit_m
    at_rest = np.linalg.norm(start_px) < REST_PX
    far_px = np.inf if at_rest else FARTHEST * np.linalg.norm(start_px)
    best_px, least = start_px, np.inf
    beside_px = BESIDE_PX * np.eye(3)[:2]
    around_px = [share * start_px for share in AROUND]
    starts_px = [start_px, *beside_px, *-beside_px] if at_rest else around_px
    trial, most = count(), TRIALS * len(starts_px)  # Often fewer are needed.
    for first_px in starts_px:
        options = {"initial_tr_radius": RADIUS_PX, "final_tr_radius": END_PX, "maxfev": TRIALS}
        result = minimize(misfit, first_px, method="COBYQA", options=options)
        if result.fun < least and np.linalg.norm(result.x - start_px) <= far_px:
            best_px, least = result.x, result.fun
    progress.count("trials of the motion", most, most)
    if least == 0:
        raise DecodeError(
            "with the assumed motion, no point stays in the camera's picture during all frames: "
            "give a smaller motion, in metres"
        )
    return best_px * unit_m


def steady_transforms(
    motion_m: Float[np.ndarray, "3"], time: Float[np.ndarray, " n"]
) -> arrays.FloatArray_n_4_4:
    """Return `T_then_now` of `take_back` for a motion per unit of time [m]; it is 1 at time 0."""
    T = np.tile(np.eye(4), (len(time), 1, 1))
    T[:, :3, 3] = np.multiply.outer(time, motion_m)
    return T


def _pixel_m(rig: Rig) -> Float[np.ndarray, "3"]:
    """Return the motions along x, y and z that move a place by one pixel, in mid range."""
    middle_m = 2 / (1 / rig.near_m + 1 / rig.far_m)
    baseline_m = float(np.linalg.norm(rig.T_cam_proj[:3, 3]))
    x_m, y_m = middle_m / rig.camera.fx_px, middle_m / rig.camera.fy_px
    return np.array([x_m, y_m, middle_m**2 / (rig.projector.fx_px * baseline_m)])


class _Likelihood:
    """The mean log-likelihood of a motion, per pixel and picture."""

    def __init__(self, frames: arrays.UInt8or16Array_n_h_w, code: Code, rig: Rig) -> None:
        self._rig = rig
        blurred = [cv2.GaussianBlur(f.astype(np.float32), (0, 0), BLUR_PX) for f in frames]
        self._frames = np.stack(blurred)
        light = light_of_frames(code)
        blur_px = math.hypot(BLUR_PX * rig.projector.fx_px / rig.camera.fx_px, 1.0)
        self._share = gaussian_filter1d(light.share, blur_px, axis=1, mode="nearest")
        self._axis = light.axis
        self._pixels = _pixels(self._frames, rig)

    def __call__(self, T_then_now: arrays.FloatArray_n_4_4) -> float:
        pixels = self._pixels
        shift = displacements(self._rig, T_then_now)
        moved = np.stack([at_nearness(shift, near) for near in pixels.nearness])
        misfit = _misfits(self._frames, moved, pixels, self._share, self._axis)
        return -float(misfit.mean())


class _Pixels(NamedTuple):
    """Pixels, and the places of the projector that light them at each nearness."""

    x: Int[np.ndarray, " p"]
    y: Int[np.ndarray, " p"]
    nearness: Float32[np.ndarray, " depths"]
    place: Float32[np.ndarray, "depths 2 p"]


def _pixels(frames: Float32[np.ndarray, "n h w"], rig: Rig) -> _Pixels:
    """Return the pixel in the middle of each tile and the one with the steepest mean picture.

    Surfaces fix the motion towards the camera, and edges the one across.
    """
    mean = frames.mean(axis=0)
    steepness = np.hypot(*(cv2.Sobel(mean, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))))
    y_ends, x_ends = (np.arange(TILES + 1) * size // TILES for size in mean.shape)
    pixel = []
    for top, bottom in pairwise(y_ends):
        for left, right in pairwise(x_ends):
            tile = steepness[top:bottom, left:right]
            dy, dx = np.unravel_index(tile.argmax(), tile.shape)
            pixel += [((top + bottom) // 2, (left + right) // 2), (top + dy, left + dx)]
    y, x = np.array(pixel).T
    ray = picture_rays(rig.camera)[y, x][None]
    nearness = nearnesses(rig, step_px=STEP_PX)
    place = np.stack([places(rig, ray, near)[:, 0] for near in nearness.tolist()])
    return _Pixels(x, y, nearness.astype(np.float32), place)


@kernel(error_model="numpy")
def _misfit(value, place, moved, share, axis):
    """Return half of log(1 - r^2), where r is the correlation of a pixel's values and light."""
    n = len(value)
    a = aa = b = bb = ab = np.float32(0)
    for k in range(n):
        v, s = value[k], share[k, 0]
        if axis[k] < 2:
            s = share_at(share[k], place[axis[k]] + moved[k])
        a += v
        aa += v * v
        b += s
        bb += s * s
        ab += v * s
    spread, common = (aa - a * a / n) * (bb - b * b / n), ab - a * b / n
    if not spread > 0 or common <= 0:
        return 0.0
    return math.log(1 - min(float(common * common / spread), MOST_SHARE)) / 2


@kernel(error_model="numpy")
def _follow(stack, moved, x, y, axis, value, shift):
    """Read a point's values in all pictures, and the motion of its place; say if all are inside."""
    n, h, w = stack.shape
    grid = moved.shape[1]
    at_x, at_y = x * np.float32((grid - 1) / (w - 1)), y * np.float32((grid - 1) / (h - 1))
    left, top = min(int(at_x), grid - 2), min(int(at_y), grid - 2)
    tx, ty = at_x - np.float32(left), at_y - np.float32(top)
    own = np.zeros(4, dtype=np.float32)
    for k in range(n):
        for c in range(4):
            first = between(moved[k, top], left, tx, c)
            own[c] = first + ty * (between(moved[k, top + 1], left, tx, c) - first)
        value[k] = value_at(stack[k], x + own[0], y + own[1])
        if value[k] < 0:
            return False
        if axis[k] < 2:
            shift[k] = own[2 + axis[k]]
    return True


@kernel(parallel=True, error_model="numpy")
def _misfits(stack, moved, pixels, share, axis):
    """Return the smallest misfit of each pixel over all depths; 0 if it leaves the pictures."""
    n, depths = len(stack), len(pixels.place)
    result = np.zeros(len(pixels.x))
    for p in numba.prange(len(pixels.x)):
        x, y = np.float32(pixels.x[p]), np.float32(pixels.y[p])
        place = pixels.place[:, :, p]
        value, shift = np.zeros(n, dtype=np.float32), np.zeros(n, dtype=np.float32)
        best, at = 0.0, -1
        for d in range(depths):
            if _follow(stack, moved[d], x, y, axis, value, shift):
                misfit = _misfit(value, place[d], shift, share, axis)
                if misfit < best:
                    best, at = misfit, d
        if at < 0:
            continue
        _follow(stack, moved[at], x, y, axis, value, shift)
        for j in range(-FINE, FINE + 1):
            other = min(max(at + int(np.sign(j)), 0), depths - 1)
            near = place[at] + np.float32(abs(j) / FINE) * (place[other] - place[at])
            best = min(best, _misfit(value, near, shift, share, axis))
        result[p] = best
    return result
