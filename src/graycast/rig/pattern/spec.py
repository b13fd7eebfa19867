"""A code described by its name and parameters, for a projector of any size."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import Field

from ...base.public_value import public_value
from ...base.settings import check_fields
from .code import Code, gray, gray_line_shift, gray_phase, micro_phase, multi_frequency, xor_gray
from .frame import Axis

Codec = Literal[
    "gray", "gray_phase", "gray_line_shift", "multi_frequency", "micro_phase", "xor_gray"
]
CODECS: tuple[Codec, ...] = get_args(Codec)
_MAKERS: dict[Codec, Callable[..., Code]] = {
    "gray": gray,
    "gray_phase": gray_phase,
    "gray_line_shift": gray_line_shift,
    "multi_frequency": multi_frequency,
    "micro_phase": micro_phase,
    "xor_gray": xor_gray,
}


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class CodeSpec:
    """The code that a scanner projects. A parameter that is None has the default of the codec.

    `base_bit` is the bit with which `xor_gray` combines the coarser bits.
    """

    codec: Annotated[Codec, Field(description="The code of projector positions.")] = "gray"
    axes: Annotated[
        tuple[Axis, ...],
        Field(
            description="The axes that are coded. Depth needs the axis that is parallel to "
            "the baseline."
        ),
    ] = ("column", "row")
    inverses: Annotated[
        bool | None, Field(description="Whether the inverse of each binary pattern is also shown.")
    ] = None
    period_px: Annotated[
        float | None,
        Field(gt=0, description="The period of phase patterns and lines in projector pixels."),
    ] = None
    fine_period_px: Annotated[
        float | None,
        Field(
            ge=2,
            description="The period of a second, finer phase of the code gray_phase, in projector "
            "pixels. Where the two phases disagree, light came from another surface.",
        ),
    ] = None
    steps: Annotated[
        int | None, Field(ge=3, description="The number of phase shifts of each period.")
    ] = None
    base_bit: Annotated[
        int | None,
        Field(
            ge=0, description="The bit with which coarser bits are combined, in the code xor_gray."
        ),
    ] = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.codec not in _MAKERS:
            raise ValueError(f"no codec {self.codec!r}: choose one of {', '.join(CODECS)}")
        foreign = [name for name in self._settings() if name not in self.parameters]
        if foreign:
            theirs = ", ".join(self.parameters)
            raise ValueError(f"{self.codec} has no {foreign[0]}; it takes {theirs}")

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters that the codec has."""
        own = inspect.signature(_MAKERS[self.codec]).parameters
        return tuple(name for name in own if name not in ("width_px", "height_px"))

    def code(self, width_px: int, height_px: int) -> Code:
        """Make the code for a projector of a given size.

        Raises:
            ValueError: the parameters do not fit a projector of that size.
        """
        return _MAKERS[self.codec](width_px, height_px, axes=self.axes, **self._settings())

    def _settings(self) -> dict[str, float | int | bool]:
        names = ("inverses", "period_px", "fine_period_px", "steps", "base_bit")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}
