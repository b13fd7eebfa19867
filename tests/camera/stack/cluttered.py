"""Healthy stacks that look faulty: dark squares, shadow with indirect light, noise, bare walls.

They have the closed form of `simulated`, with the same wall and ball.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from graycast.rig.pattern import Code, level_share

from .simulated import small_rig, view_of

TOP_DN, BLACK_DN = 255, 5.0
FAR_PX = 12.0  # window in which the pattern's mean is the indirect light


@dataclass(frozen=True, kw_only=True)
class Look:
    """Scene and light of a stack. Shares are of the picture, from its right side.

    `unlit` is a share that the projector does not reach; its own light flickers by `flicker` DN
    between frames and pixels: people, leaves, a lamp on the mains.
    """

    squares: float | None = None  # albedo of every other square of a board; None is a plain wall
    shadow: float = 0.0
    indirect: float = 0.02  # indirect light, as a share of the projector's
    unlit: float = 0.0
    flicker_dn: float = 0.0
    blur_px: float = 0.0
    bright: float = 0.75
    gain: float = 0.02
    read_dn: float = 0.5


def shoot_cluttered(code: Code, look: Look, *, seed: int = 3) -> np.ndarray:
    """Return the stack: (n, h, w) digital numbers of 8 bits."""
    scene = view_of(small_rig())
    h, w = scene.column.shape
    y, x = np.mgrid[:h, :w]
    albedo = np.full((h, w), 0.9)
    if look.squares is not None:
        albedo = np.where((x // 20 + y // 20) % 2 == 0, look.squares, albedo)
    direct = np.array([_direct(code, frame, scene) for frame in code.frames])
    if look.blur_px:
        direct = gaussian_filter(direct, (0, look.blur_px, look.blur_px))
    elsewhere = look.indirect * gaussian_filter(direct, (0, FAR_PX, FAR_PX))
    light = np.where(x < w * (1 - look.shadow), direct, 0) + elsewhere
    signal_dn = look.bright * TOP_DN * (0.02 + light * albedo)
    rng = np.random.default_rng(seed)
    noise_dn = rng.normal(size=signal_dn.shape) * np.sqrt(look.read_dn**2 + look.gain * signal_dn)
    other_dn = 0.15 * TOP_DN + rng.normal(scale=look.flicker_dn, size=signal_dn.shape)
    taken_dn = np.where(x < w * (1 - look.unlit), signal_dn + noise_dn, other_dn)
    return np.clip(np.rint(taken_dn + BLACK_DN), 0, TOP_DN).astype(np.uint8)


def _direct(code: Code, frame, scene) -> np.ndarray:
    size = 1 if frame.axis is None else code.size_px(frame.axis)
    i = 1 if frame.axis == "row" else 0
    share = level_share(frame, size, offset_px=code.offset_px[i], stride_px=code.stride_px[i])
    place = scene.row if frame.axis == "row" else scene.column
    index = np.clip(np.rint(np.nan_to_num(place)), 0, size - 1).astype(int)
    inside = np.abs(scene.column - (code.width_px - 1) / 2) < code.width_px / 2
    inside &= np.abs(scene.row - (code.height_px - 1) / 2) < code.height_px / 2
    return np.where(inside, share[index], 0.0)
