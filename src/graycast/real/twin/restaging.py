"""Reconstruction of a real scan's scene: a textured solid in the mesh of the bin.

The surfaces that a scan measured in front of the bin become one solid. Its top is the measured
surface without noise. Its sides run along the camera's rays down to the bin, so that the camera
does not see them and no light passes below the surface. A simulated scan of this scene shows the
same surfaces at the same pixels as the real scan, so that all differences come from the sensor.

Leaves out: surfaces without depth in the scan, except in small gaps; light that passes under an
overhang; objects thinner than `_THIN_M`; materials other than matt plastic or paper.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from ...base.color import linear, srgb
from ...base.errors import GraycastError
from ...base.frames import transform_points
from ...rig.meshdepth import visible_surface
from ...world.parts import Material, Mesh, Part
from ...world.scene import EMPTY_LAYOUT, Layout, Scene, bin_mesh, bin_of
from ..depth_solid import Planes, Rounds, from_nearest, solid_of, surfaces
from ..realism import DepthScan

_THIN_M = 1.5e-3  # least height of an object above the bin; errors of mesh and depth are smaller
_LEAST_BIN = 0.05  # If a smaller share of all depth is near the bin, the pose is wrong.
_LEAST_PX = 30  # Objects have at least this many pixels; mirror images in glossy walls have fewer.
_MOST_GAP_PX = 60  # Gaps up to this size are filled from the surface around them.
_BENT_M = 4e-3  # largest deviation from a plane around a gap that is filled
_LEAST_AROUND = 0.8  # This share of the pixels around a gap must have a surface.
_MOST_COVERED = 0.95  # largest share of a neighbouring pixel that an object covers
_BRIGHTEST, _WHITE_SHARE = 0.8, 0.97  # This reflectance is assigned to this quantile of the light.
_DARKEST = 0.03  # Black print and plastic reflect about as much.
_GREY = 0.5  # reflectance of a part without a picture
_ROUGHNESS = 0.5
# The last distance, 0.6 mm, is three times the noise of dark plastic.
_ROUNDS: Rounds = ((1, 3, 3e-3), (2, 3, 1.2e-3), (3, 6, 0.8e-3), (5, 6, 0.6e-3), (5, 6, 0.6e-3))


def restage(
    scans: Sequence[DepthScan],
    scene: Scene,
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]] = (),
) -> tuple[Scene, ...]:
    """Reconstruct the scene of each scan: `scene` with its bin, camera and light, and a solid part.

    The vertices of the part are in the world frame. The scene of an empty bin has no part.

    Args:
        pictures: 8-bit sRGB pictures of the same views as the depth maps, with as many pixels or
            more; without pictures, parts are grey. The brightest surfaces are assumed to be white.

    Raises:
        GraycastError: the number or shape of the pictures does not match the scans, or too little
            depth of the scans is near the bin.
    """
    camera, mesh = scene.rig.camera, bin_mesh(bin_of(scene))
    bin_m = visible_surface(scene.T_world_cam, mesh.vertices_m, mesh.faces, camera)[1]
    _refuse_elsewhere(scans, bin_m)
    before = [standing_before(scan.depth_m, bin_m) for scan in scans]
    textures = _textures(scans, before, pictures)
    staged = []
    for scan, solid, texture in zip(scans, before, textures, strict=True):
        parts: tuple[Part, ...] = ()
        if solid.any():
            planes = surfaces(scan.depth_m, solid, _ROUNDS)
            known = np.isfinite(scan.depth_m)
            planes = _without_gaps(planes, known)
            known = known | np.isfinite(planes[..., 0])
            covered = _covered(known, _brightness(texture, scene, known.shape))
            solid_mesh = solid_of(planes, bin_m, camera, covered=covered)
            world_m = transform_points(scene.T_world_cam, solid_mesh.vertices_m)
            parts = (_part(scan.name, replace(solid_mesh, vertices_m=world_m), texture),)
        staged.append(replace(scene, parts=parts))
    return tuple(staged)


def layout_of(staged: Scene) -> Layout:
    """Return the layout of a scene from `restage`: its part, if any, at the world's origin."""
    if not staged.parts:
        return EMPTY_LAYOUT
    return Layout(T_world_part=np.eye(4)[None], part_index=np.zeros(1, dtype=np.int64))


def _refuse_elsewhere(scans: Sequence[DepthScan], bin_m: Float[np.ndarray, "h w"]) -> None:
    """Refuse scans with little depth near the bin: with a wrong pose, the bin becomes a part.

    Raises:
        GraycastError: too little depth of the scans is near the bin.
    """
    near = known = 0
    for scan in scans:
        known += int(scan.valid.sum())
        with np.errstate(invalid="ignore"):  # Comparisons with NaN are false.
            near += int((np.abs(scan.depth_m - bin_m) < _THIN_M).sum())
    if near < _LEAST_BIN * known:
        raise GraycastError(
            f"fewer than {_LEAST_BIN:.0%} of the pixels with depth are within "
            f"{1e3 * _THIN_M:.1f} mm of the bin: check the bin and the camera's pose over it "
            "(graycast real fit-bin finds the pose, and --bend bends the bin to its scans). A "
            "scanner whose noise is higher than that has no twin"
        )


def standing_before(
    depth_m: Float[np.ndarray, "h w"], bin_m: Float[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels with depth in front of the bin or outside it.

    Args:
        depth_m: measured depth; NaN where it is missing.
        bin_m: depth of the empty bin; NaN outside the bin.
    """
    known = np.isfinite(depth_m)
    both = known & np.isfinite(bin_m)
    before_m = np.where(both, bin_m - depth_m, 0.0)
    # A mean over 3 x 3 pixels reduces noise. Clipping limits the effect of high objects on it.
    mean_m = _mean(np.clip(before_m, -3 * _THIN_M, 3 * _THIN_M), both, 3)
    before = (mean_m > _THIN_M) & (before_m > _THIN_M / 2)
    label, _ = ndimage.label(known & (before | ~np.isfinite(bin_m)))
    large = np.bincount(label.ravel()) >= _LEAST_PX
    large[0] = False
    return large[label]


# --- gaps and noise ------------------------------------------------------------------------------


def _without_gaps(planes: Planes, known: Bool[np.ndarray, "h w"]) -> Planes:
    """Fill small gaps of the scan with the plane that fits the surface around them, if one fits."""
    filled = planes.copy()
    label, _ = ndimage.label(~known)
    reach = 2
    for number, box in enumerate(ndimage.find_objects(label), 1):
        rows, columns = (slice(max(s.start - reach, 0), s.stop + reach) for s in box)
        gap = label[rows, columns] == number
        if gap.sum() > _MOST_GAP_PX:
            continue
        around = ndimage.binary_dilation(gap, np.ones((3, 3), dtype=bool), reach) & ~gap
        own = planes[rows, columns, 0]
        solid = around & np.isfinite(own)
        if solid.sum() < max(_LEAST_AROUND * around.sum(), 6):
            continue
        y, x = np.mgrid[: gap.shape[0], : gap.shape[1]]
        basis = np.stack([np.ones(gap.shape), x, y], axis=-1)
        plane = np.linalg.lstsq(basis[solid], own[solid], rcond=None)[0]
        if np.abs(1 / (basis[solid] @ plane) - 1 / own[solid]).max() < _BENT_M:
            inside = basis[gap] @ plane
            filled[rows, columns][gap] = np.column_stack(
                [inside, np.full(len(inside), plane[1]), np.full(len(inside), plane[2])]
            )
    return filled


def _mean(
    value: Float[np.ndarray, "h w"], counts: Bool[np.ndarray, "h w"], size_px: int
) -> Float[np.ndarray, "h w"]:
    """Return the mean of `value` in a square window around each pixel.

    Only pixels where the mask `counts` is true are averaged; the result is 0 if the window, whose
    side is `size_px`, contains none.
    """
    share = ndimage.uniform_filter(counts.astype(np.float64), size_px)
    total = ndimage.uniform_filter(np.where(counts, value, 0.0), size_px)
    return np.where(share > 1e-6, total / np.maximum(share, 1e-6), 0.0)


# --- edges ---------------------------------------------------------------------------------------


def _covered(
    known: Bool[np.ndarray, "h w"], brightness: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 4"]:
    """Return the share of each neighbour without depth (left, right, up, down) that is covered.

    A pixel that sees two surfaces has no depth if both send about equal light to the pixel. So in
    a gap of one or two pixels, the edge is assumed to divide the pixel so that their light is
    equal: a bright surface covers little of a pixel that it shares with a dark surface. In a wider
    gap, the far surface is in shadow, and the edge is assumed to be in the middle of the pixel.
    """
    covered = np.zeros((*known.shape, 4))
    for side, (axis, step) in enumerate(((1, -1), (1, 1), (0, -1), (0, 1))):
        beside, second, third = (_shifted(known, axis, k * step) for k in (1, 2, 3))
        near, far = (_shifted(brightness, axis, k * step) for k in (2, 3))
        light = np.where(second, near, far)
        share = light / (light + brightness)
        covered[..., side] = np.where(beside, 0.0, np.where(second | third, share, 0.5))
    return np.minimum(covered, _MOST_COVERED)


def _shifted(image: np.ndarray, axis: int, step: int) -> np.ndarray:
    """Return an image shifted along an axis, with the pixels at its border repeated."""
    return np.take(image, np.arange(image.shape[axis]) + step, axis=axis, mode="clip")


def _brightness(
    texture: UInt8[np.ndarray, "_ _ 3"] | None, scene: Scene, shape: tuple[int, int]
) -> Float[np.ndarray, "h w"]:
    """Return each pixel's reflectance in the projector's light; 1 without a picture."""
    if texture is None:
        return np.ones(shape)
    return linear(_at_depth(texture, shape)) @ np.array(scene.rig.band_weights)


# --- colours --------------------------------------------------------------------------------------


def _textures(
    scans: Sequence[DepthScan],
    solid: Sequence[Bool[np.ndarray, "h w"]],
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
) -> tuple[UInt8[np.ndarray, "_ _ 3"] | None, ...]:
    """Return the pictures as sRGB reflectances, scaled so that the brightest surfaces are white.

    Raises:
        GraycastError: the number or shape of the pictures does not match the scans.
    """
    if not pictures:
        return (None,) * len(scans)
    if len(pictures) != len(scans):
        raise GraycastError(
            f"{len(pictures)} colour pictures are given for {len(scans)} scans: give one picture "
            "for each scan, in the same order, or none"
        )
    light, bright = [], []
    for scan, own, picture in zip(scans, solid, pictures, strict=True):
        (height, width), (own_height, own_width) = scan.depth_m.shape, picture.shape[:2]
        if min(own_height / height, own_width / width) < 0.99 or (
            abs(own_height * width - own_width * height) > 0.01 * own_width * height
        ):
            raise GraycastError(
                f"{scan.name}: its colour picture has {own_width} x {own_height} pixels and the "
                f"depth map {width} x {height}: give a picture of the same view that has the same "
                "shape and as many pixels or more"
            )
        value = linear(picture)
        # A picture mapped onto depth is black where colour is missing; fill in the nearest colour.
        black = ndimage.binary_dilation(picture.max(axis=-1) <= 2, np.ones((3, 3), dtype=bool))
        if not black.all():
            value = from_nearest(value, black)
        light.append(value)
        bright.append(_at_depth(value, own.shape)[own].max(axis=-1))
    every = np.concatenate(bright)
    white = float(np.quantile(every, _WHITE_SHARE)) if len(every) else 1.0
    factor = _BRIGHTEST / max(white, 1e-6)
    return tuple(srgb(np.clip(factor * value, _DARKEST, 0.9)) for value in light)


def _at_depth(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Sample a picture of the same view at each pixel of the depth map."""
    height, width = shape
    rows = np.arange(height) * image.shape[0] // height
    return image[np.ix_(rows, np.arange(width) * image.shape[1] // width)]


def _part(name: str, mesh: Mesh, texture: UInt8[np.ndarray, "_ _ 3"] | None) -> Part:
    material = Material(base_color=(_GREY,) * 3, texture=texture, roughness=_ROUGHNESS)
    return Part(
        name=name,
        mesh=mesh,
        material=material,
        density_kg_m3=1000.0,
        friction=0.5,
        source="a real scan",
    )
