"""Process a stack: read pictures, measure noise, decode, triangulate, and average."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Num, UInt8

from ...base import array_types as arrays
from ...base.errors import DecodeError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...rig.optics import mask_points
from ...rig.pair import Rig
from ...rig.pattern import Code
from ..decode import (
    CodeMap,
    DecodeSpec,
    DepthMap,
    FilterSpec,
    Levels,
    Reason,
    decode,
    epipolar_residual_px,
    separate,
    triangulate,
    triangulation_axis,
    without_doubt,
    without_doubtful_positions,
)
from ..decode.plan import plan_axes
from ..sigma import with_ripple
from .averaging import join_pixels, meet_rays
from .believed_depth import believed_depth, epipolar_limit_px
from .description import StackDescription, code_of, read_description
from .diagnosis import diagnose
from .idle_settings import idle_settings
from .levels import MeasuredLevels, measure_levels
from .rig_fit import better_reading, doubts, size_symptom, symptoms
from .stack_figures import StackFigures, figures_of
from .stack_pictures import StackPictures, read_color, read_pictures
from .steady import Motion, describe_steady, taken_back

DECODED_AT_LEAST = 0.01  # A stack is refused unless a larger share of its lit pixels is decoded.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Points in the camera frame [m], with 8-bit colours from the camera's pictures.

    An averaged cloud has `sure_pixels`, the number of averaged camera pixels (0 if the finest bit
    was uncertain in all pixels). Any other cloud has `sigma_m`, the standard deviation of z [m],
    and `p_wrong`, the probability that z is wrong, if it was estimated.
    """

    point_m: arrays.FloatArray_n_3
    color: arrays.UInt8Array_n_3
    sure_pixels: arrays.IntArray_n | None = None
    sigma_m: arrays.FloatArray_n | None = None
    p_wrong: arrays.FloatArray_n | None = None

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if getattr(self, name) is not None:
                getattr(self, name).flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class StackResult:
    """The result of decoding a stack. Without a rig there is no depth and no cloud.

    `light` is direct and global light [DN above offset], or None if the code cannot separate them.
    `p_wrong` is the probability that a depth, or without a rig a position, is wrong; it is NaN
    without depth or position, and None if `max_p_wrong` is 1. `motion_m` is the motion of the scene
    from picture to picture in the coordinates of the camera, if the pictures were taken back.
    """

    code: Code
    codes: CodeMap
    picture: arrays.UInt8Array_h_w_3
    levels: MeasuredLevels
    figures: StackFigures
    warnings: tuple[str, ...]
    notes: tuple[str, ...]  # Facts that the stack does not determine, and settings without effect
    seconds: dict[str, float]
    depth: DepthMap | None = None
    p_wrong: arrays.FloatArray_h_w | None = None
    cloud: Cloud | None = None
    light: tuple[arrays.FloatArray_h_w, arrays.FloatArray_h_w] | None = None
    motion_m: Motion | None = None


def decode_stack(
    path: Path | str,
    rig: Rig | None = None,
    *,
    average: bool = False,
    filters: FilterSpec | None = None,
    motion_m: Motion | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> StackResult:
    """Decode the stack that a YAML file describes.

    With a rig, depth is computed from the coded axis along the baseline, and the other axis serves
    as a check. `average` joins the camera pixels of each projector pixel into one point of the
    cloud, and leaves the depth map unchanged. `filters` apply to depth, but not to averaged clouds.
    If a scene moves steadily, `motion_m` is its assumed motion from picture to picture along the
    axes of the camera. It is estimated (see `steady_motion`) and taken back before decoding.

    Raises:
        ConfigError: the stack file has a wrong value.
        DecodeError: pictures are missing, damaged or of different sizes; the frames are no code;
            nothing is lit; the rig has another camera; an axis that is needed is not coded.
    """
    path = Path(path)
    clock, description = _Clock(), read_description(path)
    spec, stated_px = description.decode_spec()
    code = code_of(description, path)
    _check_axes(code, spec, rig, average, path)
    pictures, levels, motion_m = _read(description, code, rig, motion_m, path, clock, progress)
    codes = with_ripple(decode(pictures.frames, code, spec, levels.levels), code)
    clock.lap("decode")
    diagnosis = diagnose(pictures, code, codes, spec, levels.levels, known=description.levels)
    warnings = [*diagnosis.warnings, *(size_symptom(code, rig) if rig else [])]
    _check_light(pictures, codes, warnings, path)
    picture = _picture(pictures, code)
    clock.lap("diagnosis")
    depth = cloud = residual_px = p_wrong = None
    by_noise, limit, evidence = codes, spec.max_p_wrong, (pictures.frames, code, levels.levels)
    notes = describe_steady(pictures, motion_m, max_p_wrong=limit)
    if rig is None:
        positions, p_wrong = without_doubtful_positions(codes, *evidence, max_p_wrong=limit)
    else:
        _refuse_turned(codes, rig, path)
        first = triangulate(codes, rig)
        residual_px = epipolar_residual_px(codes, first, rig) if len(code.axes) == 2 else None
        by_noise = _by_noise(pictures, code, spec, levels.levels, codes)
        limit_px = epipolar_limit_px(stated_px, residual_px)
        positions, sure = without_doubt(codes, first, rig, *evidence, max_p_wrong=limit)
        depth = believed_depth(codes, sure, residual_px, rig, stated_px=stated_px, filters=filters)
        if not diagnosis.explained:
            warnings += symptoms(codes, rig, first, residual_px)
            notes += doubts(codes, rig)
        clock.lap("triangulate")
        cloud = _pixel_cloud(depth, rig, picture)
        if average:
            joined = _positions_with_depth(by_noise, first, sure)
            cloud = _joined_cloud(joined, code, rig, picture, spec.fine_bits, limit_px)
        clock.lap("cloud")
    figures = figures_of(pictures.frames, code, by_noise, residual_px, (depth or positions).reason)
    notes += idle_settings(spec, stated_px, code, rig)
    light = _light(pictures, code, levels.levels)
    clock.lap("figures")
    return StackResult(
        code=code,
        codes=positions,
        picture=picture,
        levels=levels,
        figures=figures,
        warnings=tuple(warnings),
        notes=tuple(notes),
        seconds=clock.seconds,
        depth=depth,
        p_wrong=p_wrong if depth is None else depth.p_wrong,
        cloud=cloud,
        light=light,
        motion_m=motion_m,
    )


def _read(
    description: StackDescription,
    code: Code,
    rig: Rig | None,
    motion_m: Motion | None,
    path: Path,
    clock: "_Clock",
    progress: ProgressMeter,
) -> tuple[StackPictures, MeasuredLevels, Motion | None]:
    """Return the pictures, taken back on request, their levels and the estimated motion."""
    _check_motion(motion_m, rig, path)
    pictures = read_pictures([path.parent / section.file for section in description.frames])
    _check_camera(pictures, rig, path)
    clock.lap("read")
    with _naming(path):
        levels = measure_levels(pictures.frames, code, description.levels)
    clock.lap("levels")
    if motion_m is not None and rig is not None:
        if pictures.frames.shape[1:] != _camera_shape(rig):
            raise DecodeError(_other_size(pictures.frames.shape[1:], rig, path))
        pictures, motion_m = taken_back(
            pictures, code, rig, levels.levels, start_m=motion_m, progress=progress
        )
        clock.lap("motion")
    return pictures, levels, motion_m


def _light(pictures: StackPictures, code: Code, levels: Levels):
    """Return direct and global light, or None if the code cannot separate them."""
    with suppress(DecodeError):
        return separate(pictures.frames, code, levels)
    return None


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Add the path of the stack file to errors about its frames."""
    try:
        yield
    except DecodeError as error:
        raise DecodeError(f"{path}: {error}") from error


def _by_noise(
    pictures: StackPictures, code: Code, spec: DecodeSpec, levels: Levels, codes: CodeMap
) -> CodeMap:
    """Return the codes with only the uncertainty from noise, which averaging uses.

    With noise alone, certain pixels are spread over the whole cell. With other errors of fine bits,
    pixels next to an edge of the finest bit would be uncertain and left out, which would move the
    mean of the cell by a fifth of a column.
    """
    if code.subpixel or len(code.axes) < 2:
        return codes
    return decode(pictures.frames, code, spec, levels, fine_error=0.0)


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def _check_axes(code: Code, spec: DecodeSpec, rig: Rig | None, average: bool, path: Path) -> None:
    """Check that the coded axes suffice for the options, before pictures are read."""
    with _naming(path):
        plan_axes(code, spec.fine_bits)
    if average and rig is None:
        raise DecodeError(f"{path}: averaging computes 3D points, which need a rig: give --rig")
    if average and len(code.axes) < 2:
        raise DecodeError(
            f"{path}: averaging joins pixels with equal column and row, and the stack codes "
            f"{code.axes[0]}s only: remove --average"
        )
    if rig is not None and triangulation_axis(rig) not in code.axes:
        raise DecodeError(
            f"{path}: the rig's baseline runs along its {triangulation_axis(rig)}s, and the stack "
            f"codes {code.axes[0]}s only: add those frames, or decode without a rig"
        )


def _check_motion(motion_m: Motion | None, rig: Rig | None, path: Path) -> None:
    if motion_m is not None and rig is None:
        raise DecodeError(f"{path}: motion is taken back by the depths of a rig: give --rig")


def _check_camera(pictures: StackPictures, rig: Rig | None, path: Path) -> None:
    """Refuse pictures that do not have the camera's size, even after a turn by 90 degrees."""
    if rig is not None and sorted(pictures.frames.shape[1:]) != sorted(_camera_shape(rig)):
        raise DecodeError(_other_size(pictures.frames.shape[1:], rig, path))


def _refuse_turned(codes: CodeMap, rig: Rig, path: Path) -> None:
    """Refuse pictures that are turned by 90 degrees, and name the turn that corrects them."""
    if codes.column.shape == _camera_shape(rig):
        return
    turn = better_reading(codes, rig)
    raise DecodeError(_other_size(codes.column.shape, rig, path) + (f" ({turn})" if turn else ""))


def _camera_shape(rig: Rig) -> tuple[int, int]:
    return rig.camera.height_px, rig.camera.width_px


def _other_size(shape: tuple[int, ...], rig: Rig, path: Path) -> str:
    h, w = _camera_shape(rig)
    return (
        f"{path}: pictures are {shape[1]} x {shape[0]} px, the camera of rig {rig.name} {w} x {h} "
        "px: give the rig of this stack, and pictures that were not rotated or scaled"
    )


def _check_light(pictures: StackPictures, codes: CodeMap, warnings: list[str], path: Path) -> None:
    highest, lowest = int(pictures.frames.max()), int(pictures.frames.min())
    values = f"values are {lowest} to {highest} DN"
    if (codes.reason == Reason.SHADOW).all():
        raise DecodeError(
            f"{path}: no pixel is lit, because none changes by more than its noise from frame to "
            f"frame ({values}): switch the projector on and remove the lens cap"
        )
    reason = codes.reason[codes.reason != Reason.SHADOW]
    if (reason == Reason.DECODED).mean() > DECODED_AT_LEAST:
        return
    main = Reason(int(np.bincount(reason).argmax()))
    share = f"{100 * (reason == main).mean():.0f} %"
    words = f"of the lit pixels are {main.words}"
    raise DecodeError(
        f"{path}: almost no pixel is decoded: {share} {words} ({values}): {_REMEDY[main]}"
        + (f" ({warnings[0]})" if warnings else "")
    )


_REMEDY = {
    Reason.LOW_MODULATION: "lengthen the exposure, or lower decode.min_contrast",
    Reason.SATURATED: "shorten the exposure, or state levels.saturation_dn",
    Reason.CONTRADICTORY: "check that the frames are as the stack file states",
    Reason.INTERREFLECTION: "check that frames, periods and steps are as the stack file states",
    Reason.OUTSIDE_PROJECTOR: "check the projector's size, and whether a coarse bit is swapped "
    "with its inverse",
}


def _picture(pictures: StackPictures, code: Code) -> UInt8[np.ndarray, "h w 3"]:
    """Return the scene in the projector's light: the white frame, or else the brightest values."""
    white = [k for k, frame in enumerate(code.frames) if frame.kind == "white"]
    if not pictures.converted:
        grey = pictures.frames[white[0]] if white else pictures.frames.max(axis=0)
        return np.repeat(_eight_bits(grey, pictures.frames)[..., None], 3, axis=-1)
    # A coarse bit and its inverse, or two opposite phase steps, together light the whole scene.
    lit = white[:1] or list(range(len(code.frames)))[:2]
    color = np.maximum.reduce([read_color(pictures.files[k]) for k in lit])
    return _eight_bits(color, pictures.frames)


def _eight_bits(
    values: Num[np.ndarray, "*n"], frames: Num[np.ndarray, "k h w"]
) -> UInt8[np.ndarray, "*n"]:
    if values.dtype == np.uint8:
        return values
    scale = 255 / max(int(frames.max()), 1)
    return np.clip(values * scale, 0, 255).astype(np.uint8)


# --- depth -------------------------------------------------------------------------------------


def _pixel_cloud(depth: DepthMap, rig: Rig, picture: UInt8[np.ndarray, "h w 3"]) -> Cloud:
    known = np.isfinite(depth.depth_m)
    point_m = mask_points(rig.camera, depth.depth_m, known)
    return Cloud(
        point_m=point_m,
        color=picture[known],
        sigma_m=depth.sigma_m[known],
        p_wrong=None if depth.p_wrong is None else depth.p_wrong[known],
    )


def _positions_with_depth(codes: CodeMap, before: DepthMap, after: DepthMap) -> CodeMap:
    """Return the positions without the pixels whose depth was removed between two maps."""
    removed = np.isfinite(before.depth_m) & np.isnan(after.depth_m)
    return codes.without(removed, Reason.OUTLIER)


def _joined_cloud(
    codes: CodeMap,
    code: Code,
    rig: Rig,
    picture: UInt8[np.ndarray, "h w 3"],
    fine_bits: int,
    limit_px: float,
) -> Cloud:
    cells = join_pixels(codes, code, fine_bits=fine_bits)
    point_m, miss_px = meet_rays(cells.camera_px, cells.projector_px, rig)
    good = (point_m[:, 2] >= rig.near_m) & (point_m[:, 2] <= rig.far_m) & (miss_px <= limit_px)
    x, y = np.rint(cells.camera_px[good]).astype(np.int64).T
    return Cloud(point_m=point_m[good], color=picture[y, x], sure_pixels=cells.sure_pixels[good])
