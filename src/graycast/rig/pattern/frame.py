"""The description of one picture of a coded stack, even of a stack from a real scanner.

A frame has all values that its projection and its decoding need; a code is a list of frames.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...base.public_value import public_value
from ...base.settings import check_fields

Axis = Literal["column", "row"]
AXES: tuple[Axis, Axis] = ("column", "row")
Kind = Literal["white", "black", "gray", "complementary", "phase", "line"]


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One picture. Its kind defines the brightness at projector pixel `u` along its axis:

    - `gray`: bit `bit` (0 is the finest) of the Gray code of the code value at u; with
      `xor_bit >= 0`, the exclusive-or of this bit and bit `xor_bit` (M. Gupta et al., CVPR 2011);
    - `complementary`: one bit finer than a Gray code that counts periods, which distinguishes the
      halves of a period;
    - `phase`: `(1 + cos 2 pi (u / period_px - step / steps)) / 2`; the cosine of a real scanner may
      have a `step` that is not whole;
    - `line`: one lit pixel in every `period_px` pixels, moved on by one pixel per step;
    - `white`, `black`: every pixel on, or every pixel off.

    `inverse` swaps dark and bright in a binary frame.
    """

    kind: Kind
    axis: Axis | None = None
    bit: int = -1
    inverse: bool = False
    xor_bit: int = -1
    period_px: float = 0.0
    step: int | float = 0
    steps: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.kind in ("white", "black"):
            return
        if self.axis not in AXES:
            raise ValueError(f"a {self.kind} frame has axis {self.axis!r}; give column or row")
        if self.kind == "gray" and not 0 <= self.bit < 24:
            raise ValueError(f"a gray frame has bit {self.bit}; give 0 (the finest bit) to 23")
        if self.kind == "gray" and not -1 <= self.xor_bit < 24:
            raise ValueError(
                f"a gray frame has xor_bit {self.xor_bit}; give 0 to 23, or -1 for none"
            )
        if self.kind in ("phase", "line", "complementary") and not self.period_px >= 2:
            raise ValueError(f"a {self.kind} frame has period_px {self.period_px}; give at least 2")
        if self.kind in ("phase", "line"):
            if self.steps < 3:
                raise ValueError(f"a {self.kind} frame has steps {self.steps}; give at least 3")
            if not 0 <= self.step < self.steps:
                raise ValueError(
                    f"a {self.kind} frame has step {self.step:g}; give at least 0 and less than "
                    f"its steps, which is {self.steps}"
                )
            if self.inverse:
                raise ValueError(f"a {self.kind} frame has no inverse: remove it")
        if self.kind == "line" and self.step != int(self.step):
            raise ValueError(
                f"lines move by one pixel per step: step is {self.step:g}, but it must be a whole "
                "number"
            )
        if self.kind == "line" and self.steps != self.period_px:
            raise ValueError(
                "lines move by one pixel per step, so the two must be equal: steps is "
                f"{self.steps}, period_px {self.period_px}"
            )

    @property
    def name(self) -> str:
        """Name for files, unique within a code."""
        if self.kind in ("white", "black"):
            return self.kind
        if self.kind == "gray":
            text = f"{self.axis}_bit{self.bit:02d}"
            text += f"_xor{self.xor_bit:02d}" if self.xor_bit >= 0 else ""
        elif self.kind == "complementary":
            text = f"{self.axis}_complementary_{self.period_px:g}px"
        else:
            whole, part = divmod(self.step, 1)
            text = f"{self.axis}_{self.kind}_{self.period_px:g}px_step{int(whole):02d}"
            text += f"{part:.6f}".rstrip("0")[1:] if part else ""  # Step 1.25 becomes "step01.25".
        return text + ("_inverse" if self.inverse else "")


def level_share(
    frame: Frame, size_px: int, *, offset_px: float = 0.0, stride_px: float = 1.0
) -> Float[np.ndarray, " size"]:
    """Return the brightness of a frame, from 0 to 1, at each projector pixel along its axis.

    Args:
        size_px: projector pixels along the frame's axis; 1 for white and black.
        offset_px: first projector pixel of code value 0.
        stride_px: projector pixels per code value.
    """
    u = np.arange(size_px, dtype=np.float64)
    match frame.kind:
        case "white" | "black":
            share = np.full(size_px, float(frame.kind == "white"))
        case "phase":
            share = 0.5 + 0.5 * np.cos(2 * np.pi * (u / frame.period_px - frame.step / frame.steps))
        case "line":
            share = (np.arange(size_px) % frame.steps == frame.step).astype(np.float64)
        case "complementary":
            half = code_value(u, offset_px=offset_px, stride_px=frame.period_px / 2)
            share = (gray_from_binary(half) & 1).astype(np.float64)
        case "gray":
            gray = gray_from_binary(code_value(u, offset_px=offset_px, stride_px=stride_px))
            bit = gray >> frame.bit
            if frame.xor_bit >= 0:
                bit = bit ^ (gray >> frame.xor_bit)
            share = (bit & 1).astype(np.float64)
    return 1 - share if frame.inverse else share


def code_value(
    u: Float[np.ndarray, "*n"], *, offset_px: float, stride_px: float
) -> Int[np.ndarray, "*n"]:
    """Return the code values of projector positions; each value is `stride_px` pixels wide.

    Value 0 begins at the border of pixel `offset_px`, which is at `offset_px - 1/2`.
    """
    return np.floor((u + 0.5 - offset_px) / stride_px + 1e-9).astype(np.int64)


def gray_from_binary(value: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """Return the Gray code of integers: neighbours differ in one bit (US patent 2632058, 1953)."""
    return value ^ (value >> 1)
