"""The scene of a real scan, staged again: a solid in the bin's mesh, with the picture on its top.

What a scan measured nearer than the bin becomes one solid. Its top is the measured surface without
its noise, and its sides run along the camera's rays down to the bin, where the camera does not see
them and no light passes below the surface. A scan that is simulated of this scene shows the same
surfaces at the same pixels as the real one, so that whatever differs is the sensor's.

Leaves out: surfaces that the scan lost, unless they are small gaps in others; light that passes
under an overhang; what is thinner than `_THIN_M`; other materials than matt plastic or paper.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from ...base.color import linear, srgb
from ...base.errors import GraycastError
from ...base.frames import transform_points
from ...rig.meshdepth import visible_surface
from ...rig.optics import Optics, rays
from ...world.parts import Material, Mesh, Part
from ...world.scene import EMPTY_LAYOUT, Layout, Scene, bin_mesh, bin_of
from ..realism import DepthScan

_THIN_M = 1.5e-3  # A thing stands higher above the bin, whose mesh and noise are off by less.
_LEAST_BIN = 0.05  # If less of all depth is near the bin, the pose is wrong.
_LEAST_PX = 30  # A mirror image in a glossy wall has fewer pixels than a thing.
_STEP_M = 5e-3  # Neighbours whose surfaces are farther apart are not joined.
_MOST_GAP_PX = 60  # A gap of at most so many pixels is crossed by the surface about it.
_BENT_M = 4e-3  # The surface about a gap may be this far from a plane, or the gap stays.
_LEAST_AROUND = 0.8  # This share of what is about a gap must have a surface.
_MOST_COVERED = 0.95  # A pixel beside a thing is covered by it to this share at most.
_UNDER_M = 2e-3  # The sides go so deep into the bin.
_BRIGHTEST, _WHITE_SHARE = 0.8, 0.97  # So much of all pictures is darker than this reflectance.
_DARKEST = 0.03  # Black print and plastic reflect about as much.
_GREY = 0.5  # It is for a part without a picture.
_ROUGHNESS = 0.5
# A round has the radius of the window [px], its terms (3 are a plane, 6 a paraboloid) and what is
# near to a surface [m]. A gap of 0.6 mm is three times the noise of dark plastic.
_ROUNDS = ((1, 3, 3e-3), (2, 3, 1.2e-3), (3, 6, 0.8e-3), (5, 6, 0.6e-3), (5, 6, 0.6e-3))
_WIDTHS = 1.7  # A window's radius is so many standard deviations of its weight.
_RIDGE = 1e-3  # It is in weights of pixels: it makes a slope small that few pixels show.

Planes = Float[np.ndarray, "h w 3"]  # It is inverse depth [1/m] and its change per pixel in x, y.


def restage(
    scans: Sequence[DepthScan],
    scene: Scene,
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]] = (),
) -> tuple[Scene, ...]:
    """The scene of each scan: `scene` with its bin, camera and light, and one solid part in it.

    The part is in the world frame: it lies at the identity. A scan of an empty bin has none.

    Args:
        pictures: 8-bit sRGB that shows what each depth map shows, with as many pixels or more; none
            make all parts grey. The brightest surfaces of all pictures are taken to be white.

    Raises:
        GraycastError: the pictures are not as many as the scans, or of another shape; the bin is
            hardly anywhere where the scans have depth.
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
            planes = surfaces(scan.depth_m, solid)
            known = np.isfinite(scan.depth_m)
            planes = _without_gaps(planes, known)
            known = known | np.isfinite(planes[..., 0])
            covered = _covered(known, _brightness(texture, scene, known.shape))
            made = solid_of(planes, covered, bin_m, camera)
            world_m = transform_points(scene.T_world_cam, made.vertices_m)
            parts = (_part(scan.name, replace(made, vertices_m=world_m), texture),)
        staged.append(replace(scene, parts=parts))
    return tuple(staged)


def layout_of(staged: Scene) -> Layout:
    """Where the solid of a scene of `restage` lies."""
    if not staged.parts:
        return EMPTY_LAYOUT
    return Layout(T_world_part=np.eye(4)[None], part_index=np.zeros(1, dtype=np.int64))


def _refuse_elsewhere(scans: Sequence[DepthScan], bin_m: Float[np.ndarray, "h w"]) -> None:
    """With a wrong pose, all that the scans show would stand before the bin, and be a thing.

    Raises:
        GraycastError: hardly any depth of the scans is the bin's.
    """
    near = known = 0
    for scan in scans:
        known += int(scan.valid.sum())
        with np.errstate(invalid="ignore"):  # NaN is not <
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
    """Pixels at which a thing is nearer than the bin, or at which there is no bin.

    Args:
        depth_m: as measured, NaN where nothing is.
        bin_m: depth of the empty bin, NaN beside it.
    """
    known = np.isfinite(depth_m)
    both = known & np.isfinite(bin_m)
    before_m = np.where(both, bin_m - depth_m, 0.0)
    # Noise is evened out over 3 x 3 pixels, but the bin beside a high thing stays the bin's.
    mean_m = _mean(np.clip(before_m, -3 * _THIN_M, 3 * _THIN_M), both, 3)
    before = (mean_m > _THIN_M) & (before_m > _THIN_M / 2)
    label, _ = ndimage.label(known & (before | ~np.isfinite(bin_m)))
    large = np.bincount(label.ravel()) >= _LEAST_PX
    large[0] = False
    return large[label]


def surfaces(depth_m: Float[np.ndarray, "h w"], solid: Bool[np.ndarray, "h w"]) -> Planes:
    """The surface at each pixel of the solid without the noise; NaN elsewhere.

    The inverse depth of a plane is linear over the picture, so each pixel gets the plane or the
    paraboloid of inverse depth that lies nearest to the pixels about it. These count the less the
    farther they are from the surface of the round before, so that edges stay sharp.
    """
    y, x = np.nonzero(solid)
    z_m = depth_m[y, x]
    margin = max(radius for radius, _, _ in _ROUNDS)
    inside = np.pad(solid, margin)
    value = np.pad(1 / np.where(solid, depth_m, 1.0), margin)
    fitted = np.zeros((len(y), 6))
    fitted[:, 0] = 1 / z_m
    for radius, terms, near_m in _ROUNDS:
        A, b = np.zeros((len(y), terms, terms)), np.zeros((len(y), terms))
        A[:, range(1, terms), range(1, terms)] = _RIDGE
        for dy in range(-radius, radius + 1):
            for dx in range(-radius, radius + 1):
                basis = np.array([1, dx, dy, dx * dx, dx * dy, dy * dy], dtype=np.float64)
                at = y + margin + dy, x + margin + dx
                off_m = (value[at] - fitted @ basis) * z_m**2
                weight = inside[at] * np.exp(-np.minimum((off_m / near_m) ** 2, 50.0))
                weight *= np.exp(-(dx * dx + dy * dy) / 2 * (_WIDTHS / radius) ** 2)
                A += weight[:, None, None] * np.outer(basis[:terms], basis[:terms])
                b += (weight * value[at])[:, None] * basis[:terms]
        lonely = A[:, 0, 0] < 1e-9  # the round before lies near to none: it stays
        A[lonely] = np.eye(terms)
        b[lonely] = fitted[lonely, :terms]
        fitted[:, :terms] = np.linalg.solve(A, b[..., None])[..., 0]
    planes = np.full((*solid.shape, 3), np.nan)
    planes[y, x] = fitted[:, :3]
    return planes


def solid_of(
    planes: Planes,
    covered: Float[np.ndarray, "h w 4"],
    bin_m: Float[np.ndarray, "h w"],
    camera: Optics,
) -> Mesh:
    """The solid under the surfaces, closed, in the camera frame; uv are those of the picture.

    Each pixel is a rectangle whose corners lie at the pixel's corners. Neighbours share a corner if
    their surfaces meet there.

    Args:
        covered: how much of the pixel on its left, right, upper and lower side a pixel's surface
            covers as well.
        bin_m: depth of the empty bin, NaN beside it.
    """
    height, width = covered.shape[:2]
    vertex, inverse_m = _corners(planes)
    place, slope = _places(vertex, planes)
    moved = _outwards(vertex, covered, len(place))
    deeper = inverse_m + (slope * moved).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        joined = (deeper > 0) & (np.abs(1 / deeper - 1 / inverse_m) < _STEP_M)
    pixel = place + np.where(joined[:, None], moved, 0.0)
    z_m = 1 / np.where(joined, deeper, inverse_m)
    ray = rays(camera, pixel)
    faces = _rectangles(vertex, np.isfinite(planes[..., 0]))
    low_m = np.maximum(_at(bin_m, pixel), z_m) + _UNDER_M
    rim = _rim(faces, len(z_m))
    first, second = rim.T
    sides = [
        np.stack([second, first, first + len(z_m)], axis=1),
        np.stack([second, first + len(z_m), second + len(z_m)], axis=1),
    ]
    faces = np.concatenate([faces, faces[:, ::-1] + len(z_m), *sides])
    share = (pixel + 0.5) / [width, height]
    uv = np.column_stack([share[:, 0], 1 - share[:, 1]])
    return Mesh(
        vertices_m=np.concatenate([ray * z_m[:, None], ray * low_m[:, None]]),
        faces=faces,
        corner_uv=np.concatenate([uv, uv])[faces],
    )


# --- the mesh ------------------------------------------------------------------------------------

# These are the steps from a corner's row and column to those of the four pixels about it. Corner
# (i, j) lies above and left of pixel (i, j). It lies a bit aside, as the ray of a pixel's centre
# would otherwise run along the edge between the two triangles of the pixel, and may miss both.
_ABOUT = ((-1, -1), (-1, 0), (0, -1), (0, 0))
_CORNER_PX = np.array([-0.45, -0.48])  # It is x and y from the centre of pixel (i, j).


def _corners(
    planes: Planes,
) -> tuple[Int[np.ndarray, "h1 w1 4"], Float[np.ndarray, " v"]]:
    """The vertex of each pixel about each corner, -1 where none is; each one's inverse depth."""
    height, width = planes.shape[:2]
    value = np.full((height + 1, width + 1, 4), np.nan)
    for k, (down, right) in enumerate(_ABOUT):
        own = planes @ np.array([1.0, *(_CORNER_PX - [right, down])])
        value[-down : height - down, -right : width - right, k] = own
    order = np.argsort(-value, axis=-1)  # the nearest one first, NaN last
    ordered = np.take_along_axis(value, order, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.diff(1 / ordered, axis=-1) > _STEP_M  # NaN is not
    group = np.concatenate([np.zeros_like(apart[..., :1]), apart], axis=-1).cumsum(axis=-1)
    some = np.isfinite(ordered)
    name = 4 * np.arange(group[..., 0].size).reshape(group.shape[:2])[..., None] + group
    _, number = np.unique(name[some], return_inverse=True)
    total = np.bincount(number, weights=ordered[some]) / np.bincount(number)
    vertex = np.full(value.shape, -1)
    vertex[some] = number
    back = np.argsort(order, axis=-1)
    return np.take_along_axis(vertex, back, axis=-1), total


def _places(
    vertex: Int[np.ndarray, "h1 w1 4"], planes: Planes
) -> tuple[Float[np.ndarray, "v 2"], Float[np.ndarray, "v 2"]]:
    """Where each vertex lies in the picture, and how the inverse depth changes there."""
    i, j, k = np.nonzero(vertex >= 0)
    number = vertex[i, j, k]
    count = np.bincount(number)
    down, right = np.array(_ABOUT)[k].T
    slope = planes[i + down, j + right, 1:]
    place = np.empty((len(count), 2))
    place[number] = np.column_stack([j, i]) + _CORNER_PX
    mean = [np.bincount(number, weights=own) / count for own in slope.T]
    return place, np.column_stack(mean)


def _outwards(
    vertex: Int[np.ndarray, "h1 w1 4"], covered: Float[np.ndarray, "h w 4"], count: int
) -> Float[np.ndarray, "v 2"]:
    """By how many pixels each vertex moves, so that its pixel's surface covers what it shall."""
    most, least = np.zeros((count, 2)), np.zeros((count, 2))
    for k, (down, right) in enumerate(_ABOUT):
        i, j = np.nonzero(vertex[..., k] >= 0)
        number, y, x = vertex[i, j, k], i + down, j + right
        # A corner is on the pixel's right side where the pixel is on its left, and so on.
        np.maximum.at(most[:, 0], number, covered[y, x, 1] if right else 0.0)
        np.maximum.at(least[:, 0], number, 0.0 if right else covered[y, x, 0])
        np.maximum.at(most[:, 1], number, covered[y, x, 3] if down else 0.0)
        np.maximum.at(least[:, 1], number, 0.0 if down else covered[y, x, 2])
    return np.where((most > 0) & (least > 0), 0.0, most - least)  # a thing one pixel wide stays


def _rectangles(
    vertex: Int[np.ndarray, "h1 w1 4"], solid: Bool[np.ndarray, "h w"]
) -> Int[np.ndarray, "f 3"]:
    """Two triangles for each pixel, which face the camera."""
    top_left, top_right = vertex[:-1, :-1, 3][solid], vertex[:-1, 1:, 2][solid]
    low_left, low_right = vertex[1:, :-1, 1][solid], vertex[1:, 1:, 0][solid]
    return np.concatenate(
        [
            np.stack([top_left, low_left, top_right], axis=1),
            np.stack([top_right, low_left, low_right], axis=1),
        ]
    )


def _rim(faces: Int[np.ndarray, "f 3"], count: int) -> Int[np.ndarray, "e 2"]:
    """The edges that have one face only, in its direction."""
    edge = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    name, other = edge @ [count, 1], edge @ [1, count]
    return edge[~np.isin(name, other)]


def _at(bin_m: Float[np.ndarray, "h w"], pixel: Float[np.ndarray, "v 2"]) -> np.ndarray:
    """The bin's depth at places of the picture; beside the bin that of its nearest pixel."""
    beside = ~np.isfinite(bin_m)
    if beside.all():
        return np.zeros(len(pixel))
    filled = _from_nearest(bin_m, beside)
    return ndimage.map_coordinates(filled, pixel[:, ::-1].T, order=1, mode="nearest")


# --- gaps and noise ------------------------------------------------------------------------------


def _without_gaps(planes: Planes, known: Bool[np.ndarray, "h w"]) -> Planes:
    """Small gaps of the scan get the plane of what is about them, if that is one surface."""
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
    """Over a square, of the pixels that count; 0 where none does."""
    share = ndimage.uniform_filter(counts.astype(np.float64), size_px)
    total = ndimage.uniform_filter(np.where(counts, value, 0.0), size_px)
    return np.where(share > 1e-6, total / np.maximum(share, 1e-6), 0.0)


# --- edges ---------------------------------------------------------------------------------------


def _covered(
    known: Bool[np.ndarray, "h w"], brightness: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 4"]:
    """How much of each neighbour without depth a pixel's surface covers (left, right, up, down).

    A scanner loses a pixel that sees two surfaces if both send it about as much light, so in a gap
    of one or two pixels the edge lies where they do: a bright thing covers little of a pixel that
    it shares with a dark one. Where a gap is wider, the far surface is in shadow and the edge may
    lie anywhere: half of the pixel is covered.
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
    """What lies so many pixels further along an axis; at the border the last one."""
    place = np.clip(np.arange(image.shape[axis]) + step, 0, image.shape[axis] - 1)
    return np.take(image, place, axis=axis)


def _brightness(
    texture: UInt8[np.ndarray, "_ _ 3"] | None, scene: Scene, shape: tuple[int, int]
) -> Float[np.ndarray, "h w"]:
    """Reflectance in the projector's light at each pixel; all alike without a picture."""
    if texture is None:
        return np.ones(shape)
    return linear(_at_depth(texture, shape)) @ np.array(scene.rig.band_weights)


# --- what is on it -------------------------------------------------------------------------------


def _textures(
    scans: Sequence[DepthScan],
    solid: Sequence[Bool[np.ndarray, "h w"]],
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
) -> tuple[UInt8[np.ndarray, "_ _ 3"] | None, ...]:
    """The pictures as reflectances in sRGB: one factor for all makes their brightest things white.

    Raises:
        GraycastError: they are not as many as the scans, or of another shape.
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
        value = _seen(linear(picture), picture)
        light.append(value)
        bright.append(_at_depth(value, own.shape)[own].max(axis=-1))
    every = np.concatenate(bright)
    white = float(np.quantile(every, _WHITE_SHARE)) if len(every) else 1.0
    factor = _BRIGHTEST / max(white, 1e-6)
    return tuple(srgb(np.clip(factor * value, _DARKEST, 0.9)) for value in light)


def _seen(
    value: Float[np.ndarray, "_ _ 3"], picture: UInt8[np.ndarray, "_ _ 3"]
) -> Float[np.ndarray, "_ _ 3"]:
    """With the nearest colour where a picture that was mapped onto the depth has none (black)."""
    black = ndimage.binary_dilation(picture.max(axis=-1) <= 2, np.ones((3, 3), dtype=bool))
    return value if black.all() else _from_nearest(value, black)


def _from_nearest(image: np.ndarray, missing: Bool[np.ndarray, "_ _"]) -> np.ndarray:
    """The image with the value of the nearest pixel that has one where one is missing."""
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def _at_depth(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The pixel of a finer picture of the same view at each pixel of the depth."""
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
