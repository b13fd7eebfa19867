"""A contact sheet of one scene: captured frames, measured depth and ground truth.

Each tile shows the bin from the camera's view. Linear pictures are converted to sRGB for display,
and numerical maps have a colour bar.
"""

import math
from colorsys import hls_to_rgb
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from ...base.frames import inverse, transform_points
from ...base.mask_box import mask_box
from ...base.plotting import save_png
from ...base.robust import robust_sigma
from ...camera.decode import Reason, reason_shares, triangulation_axis
from ...camera.picture import srgb_frame
from ...cell.framing import framing_line
from ...cell.simulate import Shot
from ...dataset.files.sample import labelled
from ...rig.optics import Optics, project
from ...rig.pattern import Axis, Code, Frame
from ...world.parts import Part
from .bin_view import Crop, bin_crop, depth_limits_mm

DPI = 100  # All lengths are in pixels; a point of a font is 1.39 px.
SHEET_WIDTH_PX = 2400
COLUMNS = 4
_MARGIN_PX, _GAP_PX, _HEAD_PX = 30, 18, 96
_ABOVE_PX = 36  # space for the title above a tile
_BELOW_PX = (14, 52, 84)  # space below each row: empty, for colour bars, for a legend
_COARSE_RANK = 2  # The third Gray bit of an axis has a few wide stripes.
_CLOSE_UP = 4  # size of a camera pixel in the close-up, which avoids moire

# greys for unknown values; neither occurs in the colour map with which it is used
_DARK, _LIGHT = (0.20, 0.20, 0.22), (0.66, 0.66, 0.66)
_CODE_MAP, _DEPTH_MAP, _ERROR_MAP = "viridis", "viridis_r", "RdBu_r"
_ERROR_SHARE, _ERROR_SIGMAS = 99.0, 5.0  # The error scale covers this percentile or these sigmas.
_LEAST_ERROR_MM = 0.01  # Perfect depth is stored in steps of about this size.
_ROUND = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)  # A scale ends at one of these times a power of 10.
_EDGE_POINTS = 17  # number of points on an edge, because a distorting lens bends it
# Corner k of a unit box is (k & 1, k >> 1 & 1, k >> 2), so the ends of an edge differ in one bit.
_BOX_EDGES = np.array([(k, k | bit) for bit in (1, 2, 4) for k in range(8) if not k & bit])


def draw_preview(shot: Shot, code: Code, path: Path) -> None:
    """Write the contact sheet of one scene as a PNG, completely or not at all.

    Raises:
        GraycastError: the file cannot be written.
        ValueError: see `preview`.
    """
    save_png(_sheet_of(shot, code), path, dpi=DPI)


def preview(shot: Shot, code: Code) -> Image.Image:
    """Return the contact sheet of one scene.

    Args:
        code: code with which the frames were captured.

    Raises:
        ValueError: capture and code have different numbers of frames.
    """
    canvas = FigureCanvasAgg(_sheet_of(shot, code))
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def _sheet_of(shot: Shot, code: Code) -> Figure:
    if len(shot.capture.frames) != len(code.frames):
        frames = f"{len(shot.capture.frames)} frames, and the code has {len(code.frames)}"
        raise ValueError(f"the capture has {frames}: give the code of the capture")
    sheet = _Sheet(bin_crop(shot.sample.scene, shot.sample.truth))
    _write_head(sheet.figure, shot, code)
    sheet.picture("colour picture", shot.sample.rgb)
    _draw_frames(sheet, shot, code)
    _draw_codes(sheet, shot, code)
    _draw_depths(sheet, shot)
    _draw_error(sheet, shot)
    _draw_reasons(sheet, shot)
    _draw_instances(sheet, shot)
    return sheet.figure


# --- the sheet ---------------------------------------------------------------------------------


def pixel_axes(figure: Figure, left: int, top: int, width: int, height: int) -> Axes:
    """Add axes that cover the given pixels of a figure, counted from its top left."""
    sheet_width, sheet_height = figure.get_size_inches() * DPI
    bottom = sheet_height - top - height
    return figure.add_axes(
        (left / sheet_width, bottom / sheet_height, width / sheet_width, height / sheet_height)
    )


class _Sheet:
    """A grid of equal tiles that show the same part of the picture, filled row by row."""

    def __init__(self, crop: Crop) -> None:
        width = (SHEET_WIDTH_PX - 2 * _MARGIN_PX - (COLUMNS - 1) * _GAP_PX) // COLUMNS
        self.crop = crop
        self.tile_px = (width, round(width * crop[3] / crop[2]))
        self._tops = []
        height_px = _HEAD_PX
        for below_px in _BELOW_PX:
            self._tops.append(height_px + _ABOVE_PX)
            height_px += _ABOVE_PX + self.tile_px[1] + below_px
        self.figure = Figure(figsize=(SHEET_WIDTH_PX / DPI, height_px / DPI), dpi=DPI)
        self._filled = 0

    def picture(self, title: str, image: UInt8[np.ndarray, "h w 3"]) -> Axes:
        """Show the crop of an image in the next tile, with axes in image pixels."""
        self._filled += 1
        ax = pixel_axes(self.figure, *self._corner(), *self.tile_px)
        ax.imshow(image, origin="upper", interpolation="antialiased", aspect="auto")
        left, top, crop_width, crop_height = self.crop
        ax.set(xlim=(left - 0.5, left + crop_width - 0.5), xticks=[], yticks=[])
        ax.set(ylim=(top + crop_height - 0.5, top - 0.5))
        ax.spines[:].set(color="0.6", lw=0.5)
        ax.set_title(title, loc="left", fontsize=12, weight="bold", pad=6)
        return ax

    def color_bar(self, name: str, limits: tuple[float, float], label: str) -> None:
        """Draw a colour bar below the latest tile."""
        left, top = self._corner()
        width, height = self.tile_px
        bar = pixel_axes(self.figure, left, top + height + 9, width * 11 // 20, 11)
        mappable = ScalarMappable(Normalize(*limits), colormaps[name])
        self.figure.colorbar(mappable, cax=bar, orientation="horizontal")
        bar.tick_params(labelsize=9, length=2, pad=2)
        bar.annotate(label, (1, 0.5), (14, 0), xycoords="axes fraction",
                     textcoords="offset pixels", va="center", fontsize=9)  # fmt: skip

    def _corner(self) -> tuple[int, int]:
        row, column = divmod(self._filled - 1, COLUMNS)
        return _MARGIN_PX + column * (self.tile_px[0] + _GAP_PX), self._tops[row]


def _note(ax: Axes, text: str) -> None:
    """Write a short text to the right of a tile's title."""
    ax.set_title(text, loc="right", fontsize=9, pad=6, color="0.3")


def _write_head(figure: Figure, shot: Shot, code: Code) -> None:
    sample = shot.sample
    scene, layout, manifest = sample.scene, sample.layout, sample.manifest
    rig = scene.rig
    kinds, counts = np.unique(layout.part_index, return_counts=True)
    names = [f"{n} {scene.parts[kind].name}" for kind, n in zip(kinds, counts, strict=True)]
    render = manifest["config"]["render"]
    rest = "at rest" if layout.at_rest else "NOT at rest"
    words = [
        f"rig {rig.name}, baseline {1e3 * rig.baseline_m:.0f} mm",
        f"camera {rig.camera.width_px} x {rig.camera.height_px}, "
        f"projector {code.width_px} x {code.height_px}, {len(code.frames)} frames",
        f"{render['samples']} samples, light paths over up to {render['depth']} surfaces",
        f"exposure {', '.join(f'{1e3 * t:.3g}' for t in shot.capture.times_s)} ms",
        f"{rest} after {layout.simulated_s:.2f} s (try {layout.attempt + 1}): "
        f"last moved {1e3 * layout.last_motion_m:.2g} mm, "
        f"overlap {1e3 * layout.deepest_penetration_m:.2g} mm, {layout.outside} outside",
        f"seed {manifest['dataset_seed']}",
        f"{manifest['backend']} on {manifest['device']}",
        *([f"domain {manifest['domain']['kind']}"] if "domain" in manifest else []),
    ]
    height_px = figure.get_size_inches()[1] * DPI
    left = _MARGIN_PX / SHEET_WIDTH_PX
    title = f"scene {manifest['scene_id']}:  {',  '.join(names) or 'no parts'}"
    if scene.bin is not None:
        title += f"   ({framing_line(scene, layout)})"
    figure.text(left, 1 - 34 / height_px, title, fontsize=17, weight="bold", va="center")
    figure.text(left, 1 - 70 / height_px, "   |   ".join(words), fontsize=10.5, va="center",
                color="0.25")  # fmt: skip


# --- pictures and codes ------------------------------------------------------------------------


def _draw_frames(sheet: _Sheet, shot: Shot, code: Code) -> None:
    """Draw the white frame, a coarse frame, and a close-up of the centre of the finest frame."""
    axis = triangulation_axis(shot.sample.scene.rig)
    index = [k for k, f in enumerate(code.frames) if f.axis == axis and not f.inverse]
    coarse, finest = index[min(_COARSE_RANK, len(index) - 1)], index[-1]
    crop_left, crop_top, crop_width, crop_height = sheet.crop
    width, height = (-(-side // _CLOSE_UP) for side in sheet.tile_px)
    left, top = crop_left + (crop_width - width) // 2, crop_top + (crop_height - height) // 2
    is_smaller = width < crop_width and height < crop_height
    white = sheet.picture("white frame", _frame_picture(shot, code.brightest))
    if is_smaller:
        white.add_patch(_rectangle(left, top, width, height, color="#ffcc33"))
    sheet.picture(_title(code.frames[coarse]), _frame_picture(shot, coarse))
    ax = sheet.picture(_title(code.frames[finest]), _frame_picture(shot, finest))
    if is_smaller:
        ax.images[0].set_interpolation("nearest")
        ax.set(xlim=(left - 0.5, left + width - 0.5), ylim=(top + height - 0.5, top - 0.5))
        _note(ax, f"middle, magnified to {_CLOSE_UP} x {_CLOSE_UP} per pixel")


def _title(frame: Frame) -> str:
    if frame.kind == "gray":
        stripes = f"stripes of {2 ** (frame.bit + 1)} codes"
        return f"{frame.axis} bit {frame.bit}, " + (stripes if frame.xor_bit < 0 else "XOR")
    return f"{frame.axis}, {frame.kind}, period {frame.period_px:g} px"


def _draw_codes(sheet: _Sheet, shot: Shot, code: Code) -> None:
    axis: Axis = triangulation_axis(shot.sample.scene.rig)
    position = shot.codes.column if axis == "column" else shot.codes.row
    limits = (0.0, float(code.size_px(axis) - 1))
    sheet.picture(f"decoded {axis}", painted(position, _CODE_MAP, limits))
    sheet.color_bar(_CODE_MAP, limits, f"projector {axis}")


def _frame_picture(shot: Shot, index: int) -> UInt8[np.ndarray, "h w 3"]:
    """Return a frame as a grey sRGB picture; all exposures have the same scale."""
    return np.repeat(srgb_frame(shot.capture, index)[..., None], 3, axis=-1)


def painted(
    value: Float[np.ndarray, "h w"],
    name: str,
    limits: tuple[float, float],
    *,
    unknown: tuple[float, float, float] = _DARK,
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a map in the colour map `name`, clipped at the limits; NaN becomes `unknown`."""
    low, high = limits
    share = np.clip((value - low) / max(high - low, 1e-9), 0.0, 1.0)
    color = colormaps[name](np.nan_to_num(share))[..., :3]
    color[np.isnan(value)] = unknown
    return np.round(255 * color).astype(np.uint8)


# --- depth -------------------------------------------------------------------------------------


def _draw_depths(sheet: _Sheet, shot: Shot) -> None:
    sample = shot.sample
    limits = depth_limits_mm(sample.scene, sample.truth)
    sheet.picture("perfect depth", painted(1e3 * sample.truth.depth_m, _DEPTH_MAP, limits))
    sheet.color_bar(_DEPTH_MAP, limits, "mm, both depths")
    scanned = sample.scanner_depth.depth_m
    ax = sheet.picture("scanner's depth", painted(1e3 * scanned, _DEPTH_MAP, limits))
    reason = sample.scanner_depth.reason
    own = reason_shares(reason[labelled(sample).truth.instance >= 0])
    of_parts = f"{100 * own['decoded']:.1f} % of the parts' pixels, " if own else ""
    _note(ax, f"{of_parts}{100 * reason_shares(reason)['decoded']:.1f} % of all pixels")
    sheet.color_bar(_DEPTH_MAP, limits, "mm, dark where unknown")


def _draw_error(sheet: _Sheet, shot: Shot) -> None:
    sample = shot.sample
    error_mm = 1e3 * (sample.scanner_depth.depth_m - sample.truth.depth_m)
    limit_mm = error_limit_mm(error_mm)
    limits = (-limit_mm, limit_mm)
    ax = sheet.picture(
        "scanner minus perfect", painted(error_mm, _ERROR_MAP, limits, unknown=_LIGHT)
    )
    known = error_mm[np.isfinite(error_mm)]
    if known.size:
        beyond = 100 * (np.abs(known) > limit_mm).mean()
        _note(
            ax, f"median |error| {np.median(np.abs(known)):.2f} mm, {beyond:.1f} % beyond the scale"
        )
    sheet.color_bar(_ERROR_MAP, limits, "mm, red is too far, grey unknown")


def error_limit_mm(error_mm: Float[np.ndarray, "h w"]) -> float:
    """Return the error at the ends of the colour scale: the smallest round value above the noise.

    The limit of the noise is five robust sigmas. It is the 99th percentile of the errors if this is
    smaller, or if more than half of the errors are 0. Hence outliers do not widen the scale.
    """
    size_mm = np.abs(error_mm[np.isfinite(error_mm)])
    if not size_mm.size:
        return _LEAST_ERROR_MM
    share_mm = float(np.percentile(size_mm, _ERROR_SHARE))
    limit_mm = min(share_mm, _ERROR_SIGMAS * float(robust_sigma(size_mm))) or share_mm
    limit_mm = max(limit_mm, _LEAST_ERROR_MM)
    power = 10.0 ** math.floor(math.log10(limit_mm))
    return next(step * power for step in _ROUND if step * power >= limit_mm * (1 - 1e-9))


def _draw_reasons(sheet: _Sheet, shot: Shot) -> None:
    reason = shot.sample.scanner_depth.reason
    own = reason_shares(reason[labelled(shot.sample).truth.instance >= 0])
    everywhere = reason_shares(reason)
    palette = np.array([to_rgb(r.color) for r in Reason])
    ax = sheet.picture("reasons", np.round(255 * palette[reason]).astype(np.uint8))
    for r in Reason:
        of_parts = f"{100 * own[r.label]:.1f} | " if own else ""
        words = f"{r.words} {of_parts}{100 * everywhere[r.label]:.1f} %"
        ax.plot([], [], "s", color=r.color, mec="0.4", mew=0.5, ms=9, label=words)
    ax.legend(title="shares of the parts' pixels | of all pixels "
              "(meanings: docs/reference/glossary.md)", title_fontsize=9,
              alignment="left", loc="upper left", bbox_to_anchor=(-0.01, -0.005), ncols=3,
              fontsize=9, frameon=False,
              borderpad=0.3, handletextpad=0.2, columnspacing=1.2,
              borderaxespad=0.1)  # fmt: skip


# --- instances ---------------------------------------------------------------------------------


def _draw_instances(sheet: _Sheet, shot: Shot) -> None:
    """Draw visible masks, their boxes, and the oriented boxes of visible labelled parts."""
    sample = labelled(shot.sample)
    instance = sample.truth.instance
    color = instance_colors(len(sample.layout.part_index))
    visible = np.unique(instance[instance >= 0])
    width = 1.6 if len(visible) <= 60 else 0.9
    ax = sheet.picture("visible masks", tinted(_frame_picture(shot, 0), instance, color))
    _note(ax, f"{len(visible)} instances visible, {len(color) - len(visible)} hidden")
    ax = sheet.picture("boxes of the visible masks", sample.rgb)
    for i in visible:
        ax.add_patch(_rectangle(*mask_box(instance == i), color=color[i], width_pt=width))
    ax = sheet.picture("oriented boxes", sample.rgb)
    T_cam_world = inverse(sample.scene.T_world_cam)
    for i in visible:
        part = sample.scene.parts[sample.layout.part_index[i]]
        T_cam_part = T_cam_world @ sample.layout.T_world_part[i]
        edges = box_edges_px(part, T_cam_part, sample.scene.rig.camera)
        ax.add_collection(LineCollection(list(edges), colors=[color[i]], linewidths=width))


def _rectangle(
    left: int, top: int, width: int, height: int, *, color: object, width_pt: float = 1.5
) -> Rectangle:
    """Return the outline of a rectangle of whole pixels."""
    return Rectangle((left - 0.5, top - 0.5), width, height, fc="none", ec=color, lw=width_pt)


def instance_colors(n: int) -> Float[np.ndarray, "n 3"]:
    """Return colours in which neighbouring indices differ clearly (hues by the golden section)."""
    hue = (0.07 + np.arange(n) * 0.618033988749895) % 1.0
    light = np.array([0.52, 0.64, 0.42])[np.arange(n) % 3]
    colors = [hls_to_rgb(h, level, 0.85) for h, level in zip(hue, light, strict=True)]
    return np.array(colors, dtype=np.float64).reshape(n, 3)


def tinted(
    picture: UInt8[np.ndarray, "h w 3"],
    instance: Int[np.ndarray, "h w"],
    color: Float[np.ndarray, "n 3"],
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture with tinted instances that keep their shading; index -1 is unchanged."""
    own = np.concatenate([color, np.zeros((1, 3))])[instance]  # The colour of index -1 is not used.
    shaded = own * (0.6 * 255 + 0.4 * picture)
    image = np.where(instance[..., None] >= 0, shaded, picture.astype(np.float64))
    return np.round(image).astype(np.uint8)


def box_edges_px(
    part: Part, T_cam_part: Float[np.ndarray, "4 4"], camera: Optics
) -> Float[np.ndarray, "12 points 2"]:
    """Return the twelve projected edges of a part's oriented bounding box, with lens distortion.

    Points that the lens model does not cover, such as those behind the camera, are NaN.
    """
    low, high = part.mesh.bounds_m
    unit = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)])
    corner = transform_points(T_cam_part, low + unit * (high - low))
    start, end = corner[_BOX_EDGES[:, 0]], corner[_BOX_EDGES[:, 1]]
    t = np.linspace(0.0, 1.0, _EDGE_POINTS)[:, None]
    return project(camera, start[:, None] * (1 - t) + end[:, None] * t)
