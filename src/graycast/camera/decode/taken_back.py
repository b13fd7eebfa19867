"""Take the pictures of a scene that moved rigidly in a known way back to one time.

The pictures of a moving scene show a surface point at different pixels and in different places of
the projector's picture. For each pixel of the reference time, depths of the working range are
tried. Each depth says where the point was in every picture, and which light it then received. The
depth is taken whose light correlates best with the pictures. Then each picture is changed by the
difference between the light at the reference time and the light that the point received, so that
the result is a stack of a scene at rest, with the deviations of the real pictures from the pattern.
Any decoder can read it, and still finds what contradicts.

If another surface hides a point in some of the pictures, or it is bright only from some directions,
its pictures fit no depth well, and the misfit stays in the result, for the decoder to see.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float, Int

from ...base import array_types as arrays
from ...base.errors import DecodeError
from ...base.kernels import kernel
from ...base.progress import UNWATCHED, ProgressMeter
from ...rig.optics import picture_rays
from ...rig.pair import Rig
from ...rig.pattern import AXES, Axis, Code
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

STEP_PX = 2.0  # Motion of the projector's place between two depths that are tried


def take_back(
    frames: arrays.UInt8or16Array_n_h_w,
    code: Code,
    rig: Rig,
    T_then_now: arrays.FloatArray_n_4_4,
    *,
    saturation_dn: float,
    progress: ProgressMeter = UNWATCHED,
) -> arrays.UInt8or16Array_n_h_w:
    """Return the pictures that a scene at rest would have given at the reference time.

    A pixel whose point is outside one of the pictures at every depth is 0 in all of them.

    Args:
        T_then_now: for each frame, the transform from the camera's coordinates of a surface point
            at the reference time to those at the time of the frame.
        saturation_dn: the smallest saturated value. Saturated values stay saturated, and no value
            becomes larger than this one.

    Raises:
        DecodeError: the numbers of frames and poses differ.
    """
    if not len(frames) == len(code.frames) == len(T_then_now):
        raise DecodeError(
            f"there are {len(frames)} frames and {len(T_then_now)} poses, and the code has "
            f"{len(code.frames)} frames: give one frame and one pose for each"
        )
    stack = np.ascontiguousarray(frames)
    shift, light, steps = displacements(rig, T_then_now), light_of_frames(code), _steps(code)
    ray = picture_rays(rig.camera)
    nearness = nearnesses(rig, step_px=STEP_PX)
    score = np.zeros(ray.shape[:2], dtype=np.float32)
    best = np.full(ray.shape[:2], -1.0, dtype=np.float32)
    for number, near in enumerate(nearness.tolist()):
        progress.count("depths of moving pixels", number, len(nearness))
        place, moved = places(rig, ray, near), at_nearness(shift, np.float32(near))
        _correlate(stack, moved, np.float32(near), place, light, score, best)
    progress.count("depths of moving pixels", len(nearness), len(nearness))
    result = np.zeros_like(stack)
    place = places(rig, ray, best)
    _give_back(stack, shift, best, place, light, steps, saturation_dn, result)
    return result


class _Steps(NamedTuple):
    """The phases of a code.

    Attributes:
        group: a number for the period of each frame; 0 for frames without phase.
        finest: for each axis, the finest period and its frames, filled up with -1.
        delta: the phases of these frames [rad].
    """

    group: Int[np.ndarray, " n"]
    finest: Float[np.ndarray, "2 frames"]
    delta: Float[np.ndarray, "2 n"]


def _periods(code: Code, axis: Axis) -> dict[float, list[int]]:
    """Return the frames of each period of an axis that has three or more steps."""
    steps: dict[float, list[int]] = {}
    for k, frame in enumerate(code.frames):
        if frame.kind in ("phase", "line") and frame.axis == axis:
            steps.setdefault(frame.period_px, []).append(k)
    return {period: members for period, members in steps.items() if len(members) >= 3}


def _steps(code: Code) -> _Steps:
    n = len(code.frames)
    group, finest, delta = np.zeros(n, dtype=np.int64), np.full((2, 1 + n), -1.0), np.zeros((2, n))
    for i, axis in enumerate(AXES):
        periods = _periods(code, axis)
        for members in periods.values():
            group[members] = group.max() + 1
        if periods:
            members = periods[min(periods)]
            finest[i, : 1 + len(members)] = min(periods), *members
            phases = [code.frames[k].step / code.frames[k].steps for k in members]
            delta[i, : len(members)] = 2 * math.pi * np.array(phases)
    return _Steps(group, finest, delta)


@kernel()
def _in_row(shift, y, height):
    """Return the displacements in a row, interpolated between the rows of the grid."""
    at = np.float32(y * (shift.shape[-3] - 1) / max(height - 1, 1))
    low = min(int(at), shift.shape[-3] - 2)
    first, second = shift[..., low, :, :], shift[..., low + 1, :, :]
    return first + (at - np.float32(low)) * (second - first)


@kernel(parallel=True, error_model="numpy")
def _correlate(stack, shift, near, place, light, score, best):
    """Keep the nearness at which pictures and light have the highest correlation."""
    n, h, w = stack.shape
    per_px = np.float32((shift.shape[2] - 1) / max(w - 1, 1))
    for y in numba.prange(h):
        moved = _in_row(shift, y, h)
        sums = np.zeros((5, w), dtype=np.float32)
        inside = np.ones(w, dtype=np.bool_)
        for k in range(n):
            own, picture, level, axis = moved[k], stack[k], light.share[k], light.axis[k]
            for x in range(w):
                at = np.float32(x) * per_px
                low = min(int(at), shift.shape[2] - 2)
                t = at - np.float32(low)
                value = value_at(
                    picture,
                    np.float32(x) + between(own, low, t, 0),
                    np.float32(y) + between(own, low, t, 1),
                )
                inside[x] &= value >= 0
                u = np.float32(0)
                if axis < 2:
                    u = place[axis, y, x] + between(own, low, t, 2 + axis)
                share = share_at(level, u)
                sums[0, x] += value
                sums[1, x] += value * value
                sums[2, x] += share
                sums[3, x] += share * share
                sums[4, x] += value * share
        for x in range(w):
            a, aa, b, bb, ab = sums[0, x], sums[1, x], sums[2, x], sums[3, x], sums[4, x]
            spread = (aa - a * a / n) * (bb - b * b / n)
            likeness = (ab - a * b / n) / math.sqrt(spread) if spread > 0 else 0.0
            if inside[x] and likeness > score[y, x]:
                score[y, x], best[y, x] = likeness, near


@kernel(error_model="numpy")
def _phase_place(values, moved, coarse, frames, delta):
    """Return the place that the phases of the finest period give, nearest to a coarse place.

    The phases are uneven, because the stripes moved; mean, cosine and sine are least squares.
    """
    period = frames[0]
    if period < 0:
        return coarse
    A, v = np.zeros((3, 3)), np.zeros(3)
    for j in range(len(delta)):
        k = int(frames[1 + j])
        if k < 0:
            break
        angle = delta[j] - 2 * math.pi * moved[k] / period
        c, s = math.cos(angle), math.sin(angle)
        base = np.array((1.0, c, s))
        A += np.outer(base, base)
        v += base * values[k]
    _, c, s = np.linalg.solve(A, v)
    turn = math.atan2(s, c) / (2 * math.pi)
    return (turn + np.rint(coarse / period - turn)) * period


@kernel(parallel=True, error_model="numpy")
def _give_back(stack, shift, near, place, light, steps, saturation_dn, result):
    """Write the pictures of the reference time, for the nearness of each pixel.

    Blur lowers the contrast of fine stripes, so each period has its own; the other frames, in which
    the group is 0, share the contrast of all.
    """
    n, h, w = stack.shape
    per_px = np.float32((shift.shape[2] - 1) / max(w - 1, 1))
    for y in numba.prange(h):
        row = _in_row(shift, y, h)
        values, then, now = np.empty(n), np.empty(n), np.empty(n)
        moved = np.zeros((2, n))
        for x in range(w):
            if near[y, x] < 0:
                continue
            at = np.float32(x) * per_px
            low = min(int(at), shift.shape[2] - 2)
            t = at - np.float32(low)
            grid = at_nearness(row, near[y, x])
            for k in range(n):
                values[k] = value_at(
                    stack[k],
                    np.float32(x) + between(grid[k], low, t, 0),
                    np.float32(y) + between(grid[k], low, t, 1),
                )
                for axis in range(2):
                    moved[axis, k] = between(grid[k], low, t, 2 + axis)
            for k in range(n):
                now[k] = then[k] = light.share[k, 0]
            for axis in range(2):
                coarse, finest = place[axis, y, x], steps.finest[axis]
                u = _phase_place(values, moved[axis], coarse, finest, steps.delta[axis])
                for k in range(n):
                    if light.axis[k] == axis:
                        now[k] = share_at(light.share[k], np.float32(u))
                        then[k] = share_at(light.share[k], np.float32(u + moved[axis, k]))
            for g in range(steps.group.max() + 1):
                own = (steps.group == g) | (g == 0)
                off = (then - then[own].mean()) * own
                spread = np.square(off).sum()
                contrast = (off * values).sum() / spread if spread > 0 else 0.0
                for k in range(n):
                    if steps.group[k] == g:
                        value = values[k] + contrast * (now[k] - then[k])
                        value = saturation_dn if values[k] >= saturation_dn else value
                        result[k, y, x] = min(max(np.rint(value), 0.0), saturation_dn)
