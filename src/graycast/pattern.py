"""Gray-code patterns for any projector size, and the order in which they are shown.

A pattern is what a projector is given: 8-bit grey levels, 255 is white. The value of a code is the
projector pixel itself, so code k is the pixel whose centre is at k.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image

Axis = Literal["column", "row"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One picture of the stack: 'white', 'black', or bit `bit` of an axis; bit 0 is the finest."""

    kind: Literal["white", "black", "gray"]
    axis: Axis | None = None
    bit: int = -1
    inverse: bool = False

    @property
    def name(self) -> str:
        if self.kind != "gray":
            return self.kind
        return f"{self.axis}_bit{self.bit:02d}" + ("_inverse" if self.inverse else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrayCode:
    """Binary-reflected Gray code (F. Gray, US patent 2632058, 1953) over projector pixels."""

    width_px: int
    height_px: int
    axes: tuple[Axis, ...] = ("column", "row")
    inverses: bool = False

    def __post_init__(self) -> None:
        if self.width_px < 2 or self.height_px < 2:
            size = f"{self.width_px} x {self.height_px}"
            raise ValueError(f"projector is {size} px; a code needs 2 or more on each side")
        if not self.axes or len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes are {self.axes}; give column, row or both, each once")

    def size_px(self, axis: Axis) -> int:
        """How many pixels the projector has along an axis."""
        return {"column": self.width_px, "row": self.height_px}[axis]

    def bits(self, axis: Axis) -> int:
        """How many bits tell all pixels of an axis apart."""
        return (self.size_px(axis) - 1).bit_length()

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The stack in order: white, black, then each axis from its coarsest bit down."""
        frames = [Frame(kind="white"), Frame(kind="black")]
        for axis in self.axes:
            for bit in reversed(range(self.bits(axis))):
                for inverse in (False, True) if self.inverses else (False,):
                    frames.append(Frame(kind="gray", axis=axis, bit=bit, inverse=inverse))
        return tuple(frames)

    def render(self) -> UInt8[np.ndarray, "n ph pw"]:
        """The pictures to project, in the order of `frames`."""
        image = np.empty((len(self.frames), self.height_px, self.width_px), dtype=np.uint8)
        for k, frame in enumerate(self.frames):
            image[k] = self._line(frame)
        return image

    def _line(self, frame: Frame) -> UInt8[np.ndarray, "h w"]:
        """What a frame repeats: one row for columns, one column for rows, one pixel for neither."""
        if frame.kind != "gray":
            return np.full((1, 1), 255 if frame.kind == "white" else 0, dtype=np.uint8)
        bit = (gray_from_binary(np.arange(self.size_px(frame.axis))) >> frame.bit) & 1
        level = ((bit ^ frame.inverse) * 255).astype(np.uint8)
        return level[None, :] if frame.axis == "column" else level[:, None]


def gray_from_binary(value: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """Gray code of integers: neighbours differ in one bit."""
    return value ^ (value >> 1)


def write_pngs(code: GrayCode, folder: Path) -> Iterator[Path]:
    """Write every pattern as an 8-bit PNG, numbered in the order in which they are to be shown."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, (frame, image) in enumerate(zip(code.frames, code.render(), strict=True)):
        path = folder / f"{k:02d}_{frame.name}.png"
        Image.fromarray(image).save(path)
        yield path
