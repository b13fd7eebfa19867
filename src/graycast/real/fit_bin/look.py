"""Fit of the colours of walls, floor and table, and of the lamps' level, to pictures of a bin.

The configuration's renderer renders the fitted empty bin in the configured light, and reflectances
are changed until the rendered colour of each surface (median over its pixels) equals the real one.
This accounts for shading, shadows, gloss and light from wall to wall.

A picture gives only the product of light, reflectance and exposure. Colours are therefore relative
to the floor, whose mean reflectance the user states, and to the lamps' own colours. The level of
lamps and environment stays as configured, unless there are two frames of the measuring camera, with
white and with black projected: their ratio compares lamps with projector for any reflectance.

Leaves out: textures, because a surface gets one colour. Gloss, reflectance at the projector's
wavelength and the positions of lamps stay as configured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import maximum_filter, minimum_filter

from ...base.color import linear
from ...base.errors import GraycastError
from ...base.frames import transform_points
from ...camera.light import veiled
from ...camera.picture import idle_share
from ...cell.resolve import Cell
from ...rendering import Quality, Renderer, Rendering
from ...rig.pair import Rig
from ...world.parts import Material
from ...world.scene import EMPTY_LAYOUT, Scene, bin_of
from .bin_views import BinView, Grid
from .shape import NO_FACE, BinShape, height_over, is_floor

SURFACES = ("walls", "floor", "table")
_ACROSS_PX = 256
_SAMPLES = 64
_ROUNDS = 12
_SETTLED = 0.003  # Iteration stops when all relative changes of reflectance are smaller.
_EXPONENT = 0.9  # It damps each step, because light between walls grows faster than reflectance.
_LEAST_PX = 60
_NEAR_M = 0.004  # largest distance between a surface and the depth of its pixels
_DARK, _BRIGHT = 6, 250  # Darker 8-bit values are noise, and brighter ones are clipped.

Color = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """Linear frames under a white and a black pattern, with one exposure and no dark level."""

    white: Float[np.ndarray, "h w"]
    black: Float[np.ndarray, "h w"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BinAppearance:
    """Linear reflectances of the surfaces that the pictures show.

    `pixels` counts the compared pixels; `off` is the largest remaining relative difference in any
    colour band. `light_scale` is a factor on lamps and environment; None means unknown.
    `exposure` is the linear value of the picture per radiance [1 / (W sr^-1 m^-2)].
    """

    reflectance: Mapping[str, Color]
    pixels: Mapping[str, int]
    off: float
    light_scale: float | None
    exposure: float


def fit_look(
    cell: Cell,
    shape: BinShape,
    views: Sequence[BinView],
    T_world_cam: Float[np.ndarray, "4 4"],
    *,
    floor_reflectance: float | None,
    frames: Frames | None,
    renderer: Renderer,
    seed: int,
) -> BinAppearance:
    """Return the colours with which the renderer reproduces the views' pictures.

    Args:
        cell: the resolved configuration, with the fitted size of the bin.
        shape: the shape of the cell's bin, including rim and outer walls.
        floor_reflectance: mean of the floor's three bands; None takes it from the configuration.
        frames: two frames of the first view's camera; None leaves the level of the lamps.

    Raises:
        GraycastError: no view has a picture, too little of the floor is usable, a surface would
            have to reflect more light than it receives, or the configuration has no light.
    """
    views = [view for view in views if view.rgb is not None]
    if not views:
        raise GraycastError("no view has a colour picture: give --rgb, or --pose-only")
    step, grid = views[0].step(_ACROSS_PX), views[0].grid(_ACROSS_PX)
    floor_m = bin_of(cell.scene).floor_m
    masks = [_masks(view, shape, floor_m, T_world_cam) for view in views]
    pixels = {name: sum(int(mask[name].sum()) for mask in masks) for name in SURFACES}
    names = [name for name in SURFACES if all(m[name].sum() >= _LEAST_PX for m in masks)]
    if "floor" not in names:
        raise GraycastError(
            "the pictures show too little of the floor: it may be clipped or covered"
        )
    color = {name: mean_color(material) for name, material in _materials(cell.scene).items()}
    level = floor_reflectance or float(np.mean(color["floor"]))
    scene = _scene_of_view(cell.scene, grid, T_world_cam)
    scale, off, exposure = None, np.inf, 1.0
    for _ in range(_ROUNDS):
        rendering = _render(renderer, scene, color, cell, seed)
        if frames is not None:
            lit = masks[0]["floor_depth"] | masks[0]["walls_depth"]
            scale = light_scale(*_two_lights(rendering, scene.rig), frames, lit, step)
        rgb = _picture(rendering, scene.rig, 1.0 if scale is None else scale)
        ratio = _ratios(views, masks, rgb, names, step)
        exposure = float(np.mean(np.array(color["floor"]) * ratio["floor"])) / level
        relative = {name: ratio[name] / exposure for name in names}
        off = max(float(np.abs(r - 1).max()) for r in relative.values())
        if off < _SETTLED:
            break
        color |= {n: _stepped(color[n], relative[n]) for n in names}
    _refuse_impossible({name: color[name] for name in names}, relative, level)
    return BinAppearance(
        reflectance={name: color[name] for name in names},
        pixels={name: pixels[name] for name in names},
        off=off,
        light_scale=scale,
        exposure=exposure,
    )


def mean_color(material: Material) -> Color:
    """Return a material's mean linear reflectance."""
    if material.texture is None:
        return material.base_color
    red, green, blue = linear(material.texture).reshape(-1, 3).mean(axis=0)
    return float(red), float(green), float(blue)


def recolored(material: Material, color: Color) -> Material:
    """Return a material with one colour, no texture and no mottle, which would limit the colour."""
    return replace(material, base_color=color, texture=None, mottle=0.0)


def _materials(scene: Scene) -> dict[str, Material]:
    walls = bin_of(scene).material
    return {"walls": walls, "floor": bin_of(scene).floor or walls, "table": scene.table}


def _scene_of_view(scene: Scene, grid: Grid, T_world_cam: Float[np.ndarray, "4 4"]) -> Scene:
    """Return the cell without parts, with the fitted pose and the camera of the grid."""
    rig = replace(scene.rig, camera=grid.camera, speckle_contrast=0.0)
    return replace(scene, rig=rig, T_world_cam=T_world_cam.copy(), parts=())


def _render(
    renderer: Renderer, scene: Scene, color: Mapping[str, Color], cell: Cell, seed: int
) -> Rendering:
    own = _materials(scene)
    box = replace(
        bin_of(scene),
        material=recolored(own["walls"], color["walls"]),
        floor=recolored(own["floor"], color["floor"]),
    )
    scene = replace(scene, bin=box, table=recolored(own["table"], color["table"]))
    projector = scene.rig.projector
    nothing = np.zeros((0, projector.height_px, projector.width_px), dtype=np.uint8)
    quality = Quality(samples=_SAMPLES, depth=cell.config.render.depth)
    return renderer.render(scene, EMPTY_LAYOUT, nothing, quality=quality, seed=seed)


def _picture(rendering: Rendering, rig: Rig, scale: float) -> Float[np.ndarray, "h w 3"]:
    """Return the radiance of the colour picture, with lamps and environment times `scale`."""
    radiance = rendering.radiance
    rgb = scale * radiance.ambient_rgb + idle_share(rig) * radiance.white_rgb
    if not rgb.max() > 0:
        raise GraycastError(
            "the configuration has no light for a colour picture: give light.environment or "
            "light.lamps some radiance, or the rig a picture_level"
        )
    return rgb


def _masks(
    view: BinView, shape: BinShape, floor_m: float, T_world_cam: Float[np.ndarray, "4 4"]
) -> dict[str, Bool[np.ndarray, "rows columns"]]:
    """Return masks of each surface: pixels whose depth agrees and whose colour is usable.

    Masks whose name ends in `_depth` do not depend on the colour. The table is `floor_m` below the
    inner floor.
    """
    grid, step = view.grid(_ACROSS_PX), view.step(_ACROSS_PX)
    face, _ = shape.cast(T_world_cam, grid)
    point = transform_points(T_world_cam, grid.point_m)
    # A ray that misses the bin can only hit the table, on which the bin stands.
    missed = face == NO_FACE
    off_m = np.where(missed, point[..., 2] + floor_m, height_over(shape, point, face))
    bin_surface = np.where(is_floor(shape)[face], *map(SURFACES.index, ("floor", "walls")))
    surface = np.where(missed, SURFACES.index("table"), bin_surface)
    label = np.where(np.abs(off_m) < _NEAR_M, surface, NO_FACE)
    alike = minimum_filter(label, 3) == maximum_filter(label, 3)  # all neighbours have one label
    rgb = _rgb(view)[::step, ::step]
    usable = ((rgb >= _DARK) & (rgb <= _BRIGHT)).all(axis=-1)
    masks = {}
    for i, name in enumerate(SURFACES):
        masks[f"{name}_depth"] = alike & (label == i)
        masks[name] = masks[f"{name}_depth"] & usable
    return masks


def _rgb(view: BinView) -> UInt8[np.ndarray, "h w 3"]:
    """Return a view's picture; `fit_look` takes only views that have one."""
    if view.rgb is None:
        raise ValueError(f"{view.name}: has no colour picture")
    return view.rgb


def _ratios(
    views: Sequence[BinView],
    masks: Sequence[Mapping[str, np.ndarray]],
    rgb: Float[np.ndarray, "h w 3"],
    names: Sequence[str],
    step: int,
) -> dict[str, Float[np.ndarray, "3"]]:
    """Return each surface's ratio of real to rendered colour: median over pixels, mean over views.

    Before the mean, ratios are divided by the floor's, because each view has its own exposure.
    """
    relative: dict[str, list[np.ndarray]] = {name: [] for name in names}
    floors = []
    for view, mask in zip(views, masks, strict=True):
        real = linear(_rgb(view)[::step, ::step])
        ratio = {n: np.median(real[mask[n]] / np.maximum(rgb[mask[n]], 1e-12), 0) for n in names}
        floors.append(float(ratio["floor"].mean()))
        for name in names:
            relative[name].append(ratio[name] / floors[-1])
    return {name: np.mean(floors) * np.mean(values, axis=0) for name, values in relative.items()}


def _stepped(color: Color, relative: Float[np.ndarray, "3"]) -> Color:
    red, green, blue = np.clip(np.array(color) * relative**_EXPONENT, 1e-4, 1.0)
    return float(red), float(green), float(blue)


def _two_lights(
    rendering: Rendering, rig: Rig
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], float]:
    """Return the projector's white light and all other light on the sensor, and the black leak."""
    radiance = rendering.radiance
    both = [radiance.white, radiance.ambient]
    white, ambient = (veiled(one, rig.veil) for one in both) if rig.veil else both
    return white, ambient, 1 / rig.contrast_ratio


def light_scale(
    white: Float[np.ndarray, "h w"],
    ambient: Float[np.ndarray, "h w"],
    leak: float,
    frames: Frames,
    lit: Bool[np.ndarray, "h w"],
    step: int,
) -> float:
    """Return the factor on lamps and environment that gives the measured ratio of black to white.

    With the projector's light w, its leak b w in black, and the lamps' light a times s, the ratio
    of black to white is `r = (b w + s a) / (w + s a)`, so `s = w (r - b) / (a (1 - r))`. This is
    independent of reflectance, because light from wall to wall changes w and a nearly equally. The
    result is the median over the pixels.

    Args:
        white: rendered light w of the projector.
        ambient: rendered light a of the lamps as configured.
        leak: share b of the projector's light that remains in black.
        frames: measured frames, in which every `step`-th pixel is used.
        lit: a mask of the pixels to use.

    Raises:
        GraycastError: too few pixels are bright, unclipped, and lit by projector and lamps.
    """
    real_white, real_black = frames.white[::step, ::step], frames.black[::step, ::step]
    lit = lit & (real_white > 0.05) & (real_white < 0.98) & (white > 0.05 * white.max())
    lit &= (real_black < real_white) & (ambient > 0)
    if lit.sum() < _LEAST_PX:
        raise GraycastError(
            "the white and black frames show too little of the bin: give linear pictures of one "
            "exposure that are not clipped, and a configuration with lamps or an environment"
        )
    ratio = real_black[lit] / real_white[lit]
    scale = white[lit] * (ratio - leak) / (ambient[lit] * (1 - ratio))
    return max(float(np.median(scale)), 0.0)


def _refuse_impossible(
    color: Mapping[str, Color], relative: Mapping[str, np.ndarray], level: float
) -> None:
    for name, own in color.items():
        wanted = np.array(own) * relative[name]
        if wanted.max() > 1.02:
            raise GraycastError(
                f"the {name} would reflect {wanted.max():.2f} of the light where the floor reflects"
                f" {level:.2f}: state a lower --floor-reflectance, such as "
                f"{0.8 * level / wanted.max():.2f}"
            )
