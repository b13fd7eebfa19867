"""Codes: lists of frames that identify the pixels of a projector.

A pattern is the projector's input: 8-bit grey levels, 255 is white. A decoder needs nothing but the
list of frames, so a user's own code is just another list.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from ...base import array_types as arrays
from ...base.public_value import public_value
from ...base.settings import check_fields
from .frame import AXES, Axis, Frame, Kind, level_share

GreyLevels = Callable[[arrays.FloatArray_any], arrays.UInt8Array_any]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Code:
    """A code: the frames of a stack in the order of projection.

    Code value 0 of a Gray code begins at projector pixel `offset_px` (column, row), and each value
    is `stride_px` pixels wide.
    """

    width_px: int
    height_px: int
    frames: tuple[Frame, ...]
    offset_px: tuple[float, float] = (0.0, 0.0)
    stride_px: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.width_px < 2 or self.height_px < 2:
            size = f"{self.width_px} x {self.height_px}"
            raise ValueError(f"projector is {size} px; a code needs at least 2 on each side")
        if not self.axes:
            raise ValueError("no frame carries a code: give gray or phase frames")
        twice = [f.name for f in self.frames if self.frames.count(f) > 1]
        if twice:
            raise ValueError(f"frame {twice[0]} occurs twice: remove one")
        _check_even_steps(self.frames)
        if min(self.stride_px) <= 0:
            raise ValueError(f"stride_px is {self.stride_px}; projector pixels per code, above 0")

    def code(self, width_px: int, height_px: int) -> "Code":
        """Return this code; the same method of `CodeSpec` makes a code for any size.

        Raises:
            ValueError: the projector has another size than this code.
        """
        if (width_px, height_px) != (self.width_px, self.height_px):
            raise ValueError(
                f"code is made for {self.width_px} x {self.height_px} px, and the projector has "
                f"{width_px} x {height_px}: make it for the projector's size"
            )
        return self

    @property
    def codec(self) -> str:
        """Codec name of a code that is only a list of frames."""
        return "own"

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Coded axes, columns first."""
        return tuple(axis for axis in AXES if any(f.axis == axis for f in self.frames))

    @property
    def subpixel(self) -> bool:
        """Whether decoded positions are finer than whole projector pixels."""
        return any(f.kind in ("phase", "line") for f in self.frames)

    @property
    def brightest(self) -> int:
        """Index of the white frame, or 0 without a white frame."""
        return next((k for k, frame in enumerate(self.frames) if frame.kind == "white"), 0)

    def size_px(self, axis: Axis) -> int:
        """Return the number of projector pixels along an axis."""
        return {"column": self.width_px, "row": self.height_px}[axis]

    def share(self, frame: Frame) -> arrays.FloatArray_n:
        """Return the brightness of a frame, from 0 to 1, at each projector pixel along its axis.

        White and black frames have a single value.
        """
        if frame.axis is None:
            return level_share(frame, 1)
        i = AXES.index(frame.axis)
        return level_share(
            frame,
            self.size_px(frame.axis),
            offset_px=self.offset_px[i],
            stride_px=self.stride_px[i],
        )

    def stripe_px(self, frame: Frame) -> float:
        """Return the period of a coded frame's stripes [projector px].

        Of two combined bits, it is the period of the finer one.

        Raises:
            ValueError: the frame is white or black.
        """
        if frame.axis is None:
            raise ValueError(f"a {frame.kind} frame has no stripes")
        if frame.kind != "gray":
            return frame.period_px
        finest = frame.bit if frame.xor_bit < 0 else min(frame.bit, frame.xor_bit)
        return 4 * 2**finest * self.stride_px[AXES.index(frame.axis)]

    def render(self, grey_levels: GreyLevels | None = None) -> arrays.UInt8Array_n_ph_pw:
        """Return the pictures to project, in the order of `frames`.

        Args:
            grey_levels: maps shares of white light (FloatArray_any) to grey levels
                (UInt8Array_any), as the inverse of the projector's response; None: in proportion.
        """
        to_levels = _proportional if grey_levels is None else grey_levels
        image = np.empty((len(self.frames), self.height_px, self.width_px), dtype=np.uint8)
        for k, frame in enumerate(self.frames):
            image[k] = self._line(frame, to_levels)
        return image

    def _line(self, frame: Frame, to_levels: GreyLevels) -> UInt8[np.ndarray, "h w"]:
        """Return the repeated part of a frame: a row, a column, or (without an axis) a pixel."""
        level = to_levels(self.share(frame))
        return level[None, :] if frame.axis == "column" else level[:, None]


def _check_even_steps(frames: tuple[Frame, ...]) -> None:
    """Raise an error if steps of a period with three or more frames differ by parts of a step."""
    groups: dict[tuple, list[Frame]] = {}
    for frame in frames:
        if frame.steps:
            groups.setdefault((frame.axis, frame.period_px, frame.steps), []).append(frame)
    for (axis, period_px, steps), members in groups.items():
        parts = sorted({round(frame.step % 1, 6) for frame in members})
        if len(members) >= 3 and len(parts) > 1:
            text = ", ".join(f"{frame.step:g}" for frame in members)
            raise ValueError(
                f"{axis}: the steps of period {period_px:g} px are {text} of {steps}: all of them "
                "must differ by whole steps"
            )


def _proportional(share: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    return np.round(255 * share).astype(np.uint8)


def write_pngs(
    code: Code, folder: Path, *, grey_levels: GreyLevels | None = None
) -> Iterator[Path]:
    """Write each pattern as an 8-bit PNG, numbered in the order of projection; yield its path."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, (frame, image) in enumerate(zip(code.frames, code.render(grey_levels), strict=True)):
        path = folder / f"{k:02d}_{frame.name}.png"
        Image.fromarray(image).save(path)
        yield path


# --- the codes of real scanners ----------------------------------------------------------------


def gray(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = AXES,
    inverses: bool = False,
) -> Code:
    """Make a binary-reflected Gray code of single projector pixels, coarsest bit first."""
    sizes = _sizes(axes, width_px, height_px)
    frames = [frame for axis in axes for frame in _gray_bits(axis, sizes[axis], inverses)]
    return Code(width_px=width_px, height_px=height_px, frames=(*_ENDS, *frames))


def gray_phase(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = ("column",),
    inverses: bool = False,
    period_px: float = 16.0,
    fine_period_px: float | None = None,
    steps: int = 8,
) -> Code:
    """Make a Gray code that counts periods, a complementary bit, and a cosine in `steps` steps.

    The complementary bit distinguishes the halves of a period, so that a Gray edge that is wrong by
    up to a quarter of a period does not cause a jump by 2 pi. A second cosine of `fine_period_px`
    makes positions more precise. Light that arrives by way of another surface shifts the two
    cosines by different distances, so it can be distinguished from direct light.
    """
    if fine_period_px is not None and not fine_period_px < period_px:
        raise ValueError(
            f"fine_period_px is {fine_period_px:g} and period_px {period_px:g}; the fine period "
            "must be the smaller one"
        )
    sizes = _sizes(axes, width_px, height_px)
    frames: list[Frame] = []
    for axis in axes:
        frames += _gray_bits(axis, math.ceil(sizes[axis] / period_px), inverses)
        for inverse in (False, True) if inverses else (False,):
            frames.append(
                Frame(kind="complementary", axis=axis, period_px=period_px, inverse=inverse)
            )
        for period in (period_px, fine_period_px):
            frames += _steps("phase", axis, period, steps) if period else []
    return Code(
        width_px=width_px,
        height_px=height_px,
        frames=(*_ENDS, *frames),
        stride_px=(period_px, period_px),
    )


def gray_line_shift(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = ("column",),
    inverses: bool = False,
    period_px: float = 8.0,
) -> Code:
    """Make a Gray code that counts periods, and a comb of lines shifted pixel by pixel.

    Guehring (2001) finds each line's peak in the camera image; here the first harmonic of the
    shifts gives the position at every camera pixel. If one pixel in eight is lit, the amplitude is
    half that of a cosine, with a quarter of the light: less photon noise, and more read noise.
    """
    if period_px != int(period_px):
        raise ValueError(
            f"period_px is {period_px}; give a whole number, because lines move by whole pixels"
        )
    shifted = gray_phase(
        width_px, height_px, axes=axes, inverses=inverses, period_px=period_px, steps=int(period_px)
    )
    frames = tuple(replace(f, kind="line") if f.kind == "phase" else f for f in shifted.frames)
    return replace(shifted, frames=frames)


def multi_frequency(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = ("column",),
    period_px: float = 16.0,
    steps: int = 4,
) -> Code:
    """Make a code of three cosines whose beats count the periods (heterodyne unwrapping).

    The axis is extended by one period, so that its two ends have different phases, and then has N
    periods. The other cosines have N - sqrt(N) and N - 1 periods, which balances the noise of the
    two beats best (C. Towers, D. Towers, J. Jones, Optics Letters 28, 2003).
    """
    sizes = _sizes(axes, width_px, height_px)
    frames: list[Frame] = []
    for axis in axes:
        length_px = sizes[axis] + period_px
        count = length_px / period_px
        if count < 4:
            raise ValueError(
                f"{axis}: {count:.1f} periods of {period_px} px; give a period that fits at least "
                "4 times"
            )
        for number in (count, count - math.sqrt(count), count - 1):
            frames += _steps("phase", axis, length_px / number, steps)
    return Code(width_px=width_px, height_px=height_px, frames=(*_ENDS, *frames))


def micro_phase(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = ("column",),
    period_px: float = 16.0,
) -> Code:
    """Make a code for micro phase shifting: six short periods that are nearly equal.

    The first period has three steps, and each other period has one. Nearly equal periods have the
    same mean and amplitude. Interreflections average out such short periods and cause no error.

    Source: M. Gupta, S. Nayar, "Micro Phase Shifting", CVPR 2012; the periods are our own.
    """
    frames: list[Frame] = []
    for axis in _sizes(axes, width_px, height_px):
        frames += _steps("phase", axis, period_px, 3)
        for ratio in _MICRO_RATIOS:
            frames += _steps("phase", axis, period_px / ratio, 3)[:1]
    return Code(width_px=width_px, height_px=height_px, frames=(*_ENDS, *frames))


# From a random search: cosines of any two of 80 periods differ by over 0.24, of 120 by over 0.12.
_MICRO_RATIOS = (0.9432, 0.9077, 1.0869, 1.1273, 1.1023)


def xor_gray(
    width_px: int,
    height_px: int,
    *,
    axes: tuple[Axis, ...] = ("column",),
    inverses: bool = True,
    base_bit: int = 1,
) -> Code:
    """Make a Gray code whose coarse bits are XORed with a fine bit, so that all stripes are narrow.

    Indirect light then reaches a point from as many lit as unlit stripes, both in a pattern and in
    its inverse. `base_bit` 0 gives the stripes of XOR-02 in the source, and 1 those of XOR-04.

    Source: M. Gupta, A. Agrawal, A. Veeraraghavan, S. Narasimhan, "Structured Light 3D Scanning
    in the Presence of Global Illumination", CVPR 2011.
    """
    plain = gray(width_px, height_px, axes=axes, inverses=inverses)
    finest_top = min(max(f.bit for f in plain.frames if f.axis == axis) for axis in plain.axes)
    if not 0 <= base_bit <= max(finest_top, 1):
        raise ValueError(f"base_bit is {base_bit}; the code has bits 0 to {finest_top}")
    frames = tuple(
        replace(f, xor_bit=base_bit) if f.kind == "gray" and f.bit > base_bit else f
        for f in plain.frames
    )
    return replace(plain, frames=frames)


_ENDS = (Frame(kind="white"), Frame(kind="black"))


def _sizes(axes: tuple[Axis, ...], width_px: int, height_px: int) -> dict[Axis, int]:
    """Return the number of pixels along each coded axis."""
    if not axes or len(set(axes)) != len(axes):
        raise ValueError(f"axes are {axes}; give column, row or both, each once")
    if width_px < 2 or height_px < 2:
        size = f"{width_px} x {height_px}"
        raise ValueError(f"projector is {size} px; a code needs at least 2 on each side")
    sizes: dict[Axis, int] = {"column": width_px, "row": height_px}
    return {axis: sizes[axis] for axis in axes}


def _gray_bits(axis: Axis, values: int, inverses: bool) -> list[Frame]:
    if values < 2:
        raise ValueError(
            f"{axis}: one period spans all pixels; give a shorter period, which the Gray code "
            "counts"
        )
    return [
        Frame(kind="gray", axis=axis, bit=bit, inverse=inverse)
        for bit in reversed(range((values - 1).bit_length()))
        for inverse in ((False, True) if inverses else (False,))
    ]


def _steps(kind: Kind, axis: Axis, period_px: float, steps: int) -> list[Frame]:
    return [
        Frame(kind=kind, axis=axis, period_px=period_px, step=step, steps=steps)
        for step in range(steps)
    ]
