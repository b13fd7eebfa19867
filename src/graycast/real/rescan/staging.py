"""Reconstruction of a scene from perfect depth: meshes of the objects, and a solid for the rest.

The world is the frame of the image's camera, which is assumed to look down at the scene, with lamps
next to it as in Graycast's default cell. Surfaces outside objects become the top of a solid, whose
sides run along the camera's rays down to the neighbouring surface. Behind the objects, the top
continues as a membrane that is fixed to the known depth around them.

Leaves out: surfaces that neither the models nor the depth show, such as the back of a bin's wall
and everything outside the picture; light that passes under an overhang; and the gloss of objects
that bend or have no model, which are matt with the colours of the picture.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from ...base.color import linear, srgb
from ...base.errors import DatasetError
from ...base.frames import transform_points
from ...camera.scanner import Scanner
from ...cell.config import LightSection
from ...rig.meshdepth import rasterize
from ...rig.optics import Optics
from ...world.parts import Material, Part
from ...world.scene import Lamp, Layout, Scene
from ..depth_solid import STEP_M, Rounds, from_nearest, smooth_slopes, solid_of, surfaces
from .source import SourceImage

BACKGROUND = "background"
_NEAR_M, _NEAR_SHARE = 2e-3, 2e-3  # Depth within `_NEAR_M + _NEAR_SHARE * z` belongs to an object.
_MOST_BEHIND = 0.2  # If more of the objects' pixels have depth behind them, the poses are wrong.
_LEAST_PX = 50  # With fewer pixels of objects, their poses are not checked.
_FINE_M = 2e-4  # Depth with finer steps needs little smoothing.
_SLOPE = 6.0  # Neighbours with a steeper slope in depth are not joined.
_AROUND_PX = 5  # Sides extend to the largest depth in a square of this many pixels.
_COARSE = 4  # The membrane is computed on blocks of this many pixels.
_BRIGHTEST, _WHITE_SHARE = 0.8, 0.97  # This reflectance is assigned to this quantile of the light.
_DARKEST, _MOST = 0.03, 0.9
_GREY = Material(base_color=(0.4, 0.4, 0.4))


@dataclass(frozen=True, slots=True, kw_only=True)
class Staged:
    """An image as a scene; `obj_id` has the object ids of the scene's labelled parts, in order."""

    scene: Scene
    layout: Layout
    obj_id: tuple[int, ...]


def with_camera(scanner: Scanner, camera: Optics) -> Scanner:
    """Return the scanner with other intrinsics of its camera, at the same position.

    The focal length in metres stays the same, so the pixel pitch changes.
    """
    own = scanner.rig.camera
    lens = replace(
        own,
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        distortion=camera.distortion,
        psf_px=own.psf_px * camera.fx_px / own.fx_px,  # The blur is a fixed angle.
    )
    pitch_m = scanner.sensor.pixel_pitch_m * own.fx_px / camera.fx_px
    return replace(
        scanner,
        rig=replace(scanner.rig, camera=lens),
        sensor=replace(scanner.sensor, pixel_pitch_m=pitch_m),
    )


def stage(
    image: SourceImage,
    parts: Mapping[int, Part],
    scanner: Scanner,
    *,
    unknown_look: Collection[int] = (),
    background: Material | None = None,
) -> Staged:
    """Build the scene of an image in front of the scanner.

    Args:
        parts: parts by object id; an object without a part becomes part of the background.
        unknown_look: ids of parts without a stated material: they get the mean colour of the
            picture at their pixels.
        background: material of everything except objects; None is matt with the picture's colours.

    Raises:
        DatasetError: the depth contradicts the objects, or there is no depth.
    """
    known = np.isfinite(image.depth_m)
    if not known.any():
        raise DatasetError("the depth picture has no depth at all: give perfect depth")
    modelled = [i for i, obj_id in enumerate(image.obj_id.tolist()) if obj_id in parts]
    nearest_m, which = _nearest(image, parts, modelled)
    own = _of_objects(image.depth_m, nearest_m, image.step_m)
    _refuse_contradiction(image.depth_m, nearest_m, own)
    reflectance = None if image.rgb is None else reflectance_of(image.rgb)
    if reflectance is not None:
        colors = _mean_colors(reflectance, np.where(own, which, -1), image.obj_id)
        parts = {
            obj_id: replace(part, material=replace(part.material, base_color=colors[obj_id]))
            if obj_id in unknown_look and obj_id in colors
            else part
            for obj_id, part in parts.items()
        }
    used = sorted({int(image.obj_id[i]) for i in modelled})
    behind = _background(image, own, nearest_m, reflectance, background)
    scene = Scene(
        rig=scanner.rig,
        T_world_cam=np.eye(4),
        parts=(*(replace(parts[obj_id], labelled=True) for obj_id in used), behind),
        lamps=_lamps(float(np.nanmedian(image.depth_m))),
    )
    index = [used.index(int(image.obj_id[i])) for i in modelled]
    layout = Layout(
        T_world_part=np.concatenate([image.T_cam_part[modelled], np.eye(4)[None]]),
        part_index=np.array([*index, len(used)], dtype=np.int64),
    )
    return Staged(scene=scene, layout=layout, obj_id=tuple(used))


def _lamps(depth_m: float) -> tuple[Lamp, ...]:
    """Return the lamps of the default cell, with its floor at this depth below the camera."""
    down = np.array([1.0, -1.0, -1.0])
    middle = np.array([0.0, 0.0, depth_m])

    def turned(point_m: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (down * point_m + middle).tolist()
        return x, y, z

    return tuple(
        replace(lamp, center_m=turned(lamp.center_m), target_m=turned(lamp.target_m))
        for lamp in LightSection().lamps
    )


def _nearest(
    image: SourceImage, parts: Mapping[int, Part], modelled: Collection[int]
) -> tuple[Float[np.ndarray, "h w"], np.ndarray]:
    """Return depth [m] and instance of the nearest object at each pixel; NaN and -1 if none."""
    nearest_m = np.full(image.depth_m.shape, np.inf)
    which = np.full(image.depth_m.shape, -1)
    for i in modelled:
        mesh = parts[int(image.obj_id[i])].mesh
        vertices_cam = transform_points(image.T_cam_part[i], mesh.vertices_m)
        _, own_m = rasterize(vertices_cam, mesh.faces, image.camera).over(image.camera)
        nearer = np.nan_to_num(own_m, nan=np.inf) < nearest_m
        nearest_m[nearer], which[nearer] = own_m[nearer], i
    return np.where(which >= 0, nearest_m, np.nan), which


def _of_objects(
    depth_m: Float[np.ndarray, "h w"], nearest_m: Float[np.ndarray, "h w"], step_m: float
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the objects' pixels whose depth agrees with the object or is unknown."""
    near_m = _NEAR_M + _NEAR_SHARE * nearest_m + step_m
    with np.errstate(invalid="ignore"):  # Comparisons with NaN are false.
        agrees = np.abs(depth_m - nearest_m) < near_m
    return agrees | (np.isnan(depth_m) & np.isfinite(nearest_m))


def _refuse_contradiction(
    depth_m: Float[np.ndarray, "h w"],
    nearest_m: Float[np.ndarray, "h w"],
    own: Bool[np.ndarray, "h w"],
) -> None:
    """Refuse depth behind objects; depth in front of an object means that the object is hidden.

    Raises:
        DatasetError: depth is behind the object at many pixels.
    """
    both = np.isfinite(depth_m) & np.isfinite(nearest_m)
    with np.errstate(invalid="ignore"):
        behind = both & ~own & (depth_m > nearest_m)
    if both.sum() >= _LEAST_PX and behind.sum() > _MOST_BEHIND * both.sum():
        off_m = float(np.median((depth_m - nearest_m)[behind]))
        raise DatasetError(
            f"in {behind.sum() / both.sum():.0%} of the pixels where the models lie the depth is "
            f"farther than they are, by {1e3 * off_m:.0f} mm in the median: check the unit of the "
            "models, the poses, and the depth_scale; if depth is the length of each ray, give "
            "--ray-length"
        )


def _background(
    image: SourceImage,
    own: Bool[np.ndarray, "h w"],
    nearest_m: Float[np.ndarray, "h w"],
    reflectance: Float[np.ndarray, "h w 3"] | None,
    material: Material | None,
) -> Part:
    """Return the surfaces outside the objects as a solid in the camera frame."""
    known = np.isfinite(image.depth_m) & ~own
    depth_m = np.where(known, image.depth_m, np.nan)
    if known.any():
        depth_m = np.where(own, np.fmax(_membrane(depth_m), nearest_m + _NEAR_M), depth_m)
    else:  # If objects fill the picture, a wall far behind them stops the light.
        depth_m = np.where(own, 2 * np.nanmax(nearest_m), depth_m)
    solid = np.isfinite(depth_m)
    rounds = _rounds(image.step_m)
    planes = surfaces(depth_m, solid, rounds)
    pixel_m = float(np.nanmedian(depth_m)) / image.camera.fx_px
    mesh = solid_of(
        planes,
        ndimage.maximum_filter(np.where(solid, depth_m, 0.0), _AROUND_PX),
        image.camera,
        step_m=max(STEP_M, _SLOPE * pixel_m),
        shading=smooth_slopes(depth_m, planes, rounds[-1][2]),
    )
    if material is None:
        material = _GREY
        if reflectance is not None:
            beside = from_nearest(reflectance, own) if known.any() else reflectance
            material = replace(_GREY, texture=srgb(beside))
    return Part(
        name=BACKGROUND,
        mesh=mesh,
        material=material,
        density_kg_m3=1000.0,
        friction=0.5,
        source="a depth picture",
        labelled=False,
    )


def _rounds(step_m: float) -> Rounds:
    """Return the rounds for `surfaces`; depth with coarse steps is smoothed over more pixels."""
    near_m = 3e-4 + 2 * step_m
    fine: Rounds = ((1, 3, 2 * near_m), (2, 3, near_m))
    return fine if step_m <= _FINE_M else (*fine, (5, 6, near_m), (5, 6, near_m))


def _membrane(depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Fill gaps in depth by solving Laplace's equation for inverse depth on blocks of pixels.

    With inverse depth, a plane continues as a plane.
    """
    known = np.isfinite(depth_m)
    rows, columns = (-(-size // _COARSE) for size in depth_m.shape)
    margin = [(0, n * _COARSE - size) for n, size in zip((rows, columns), known.shape, strict=True)]
    blocks = (rows, _COARSE, columns, _COARSE)

    def total(value: np.ndarray) -> np.ndarray:
        return np.pad(value, margin).reshape(blocks).sum(axis=(1, 3))

    count = total(known.astype(np.float64))
    coarse = total(np.where(known, 1 / np.where(known, depth_m, 1.0), 0.0)) / np.maximum(count, 1)
    free = count == 0
    if free.any():
        coarse[free] = _solved(coarse, free)
    at = [
        np.clip((np.arange(size) + 0.5) / _COARSE - 0.5, 0, n - 1)
        for n, size in zip((rows, columns), known.shape, strict=True)
    ]
    fine = ndimage.map_coordinates(coarse, np.meshgrid(*at, indexing="ij"), order=1)
    return np.where(known, depth_m, 1 / fine)


def _solved(value: Float[np.ndarray, "h w"], free: Bool[np.ndarray, "h w"]) -> np.ndarray:
    """Return the values of the free blocks so that each is the mean of its neighbours.

    The Laplacian has no differences across the border, so the border is a mirror.
    """
    rows, columns = (sparse.diags([-1.0, 1.0], [0, 1], shape=(n - 1, n)) for n in free.shape)
    laplacian = sparse.kronsum(columns.T @ columns, rows.T @ rows).tocsr()[free.ravel()]
    right_side = -laplacian[:, ~free.ravel()] @ value[~free]
    return spsolve(laplacian[:, free.ravel()].tocsc(), right_side)


def reflectance_of(rgb: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Estimate reflectance from the linear values of a picture whose brightest areas are white."""
    light = linear(rgb)
    white = float(np.quantile(light.max(axis=-1), _WHITE_SHARE))
    return np.clip(light * (_BRIGHTEST / max(white, 1e-3)), _DARKEST, _MOST)


def _mean_colors(
    reflectance: Float[np.ndarray, "h w 3"], which: np.ndarray, obj_id: np.ndarray
) -> dict[int, tuple[float, float, float]]:
    """Return the mean reflectance of each visible object, by object id."""
    visible = which >= 0
    of = obj_id[which[visible]]
    color = reflectance[visible]
    means: dict[int, tuple[float, float, float]] = {}
    for i in np.unique(of):
        red, green, blue = color[of == i].mean(axis=0).tolist()
        means[int(i)] = red, green, blue
    return means
