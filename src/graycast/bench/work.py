"""The progress of a long study: completed work over all work, in megapixel samples of Cycles."""

import math
from collections.abc import Callable
from typing import cast, final

from ..cell import Cell
from ..pattern import Code
from ..render import FrameByFrame, Renderer

OnWork = Callable[[float, str], None]  # share of the whole that is done, and what is going on

ONE_PASS = 0.4  # what all patterns in one pass take, over a frame of Cycles
DENOISING = 4.0  # what denoising a frame takes, in samples


@final
class Work:
    """Counts what is done and tells its share of the whole."""

    def __init__(self, total: float, on_work: OnWork):
        self._total, self._done, self._on_work = total, 0.0, on_work
        self.what = ""

    def did(self, amount: float) -> None:
        self._done += amount
        self._on_work(min(self._done / self._total, 1.0), self.what)

    def begin(self, what: str) -> None:
        """Name what comes next."""
        self.what = what
        self.did(0.0)

    def follow(self, renderer: Renderer, amount: float) -> None:
        """Share an amount out over the frames of Cycles' next stacks; others are silent."""
        if (each := by_frames(renderer)) is not None:
            each.on_frame = lambda done, total: self.did(amount / total)


def needed(code: Code) -> list[int]:
    """Numbers of the patterns that Cycles renders for themselves: white and black are not."""
    return [k for k, frame in enumerate(code.frames) if frame.kind not in ("white", "black")]


def by_frames(renderer: Renderer) -> FrameByFrame | None:
    """Cycles, as what renders frame by frame; None of any other renderer."""
    return cast(FrameByFrame, renderer) if renderer.name == "cycles" else None


def renders(renderer: Renderer, patterns: int) -> int:
    """How many renders a renderer makes of so many patterns."""
    each = by_frames(renderer)
    return 1 if each is None else math.ceil(patterns / each.patterns_per_render)


def stack_work(renderer: Renderer, cell: Cell, samples: int, denoise: str) -> float:
    """The work of a whole stack, roughly."""
    camera, patterns = cell.scene.rig.camera, len(needed(cell.code))
    megapixels = 1e-6 * camera.width_px * camera.height_px
    extra = 0.0 if denoise == "none" else DENOISING
    if renderer.name == "cycles":
        return megapixels * (samples + extra) * (renders(renderer, patterns) + 2)
    return megapixels * (ONE_PASS * samples + extra * patterns)
