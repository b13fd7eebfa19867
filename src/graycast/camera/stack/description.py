"""The YAML description of a stack: projector, frames, levels and thresholds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, model_validator

from ...base.errors import ConfigError
from ...base.sections import read_as, section_of
from ...base.settings import Level, Positive, Settings, read_settings
from ...rig.pattern import AXES, Axis, Code, Frame
from ..decode import DecodeSpec, levels_of
from ..rig_file import load_scanner
from ..scanner import Scanner

_MUST: dict[str, tuple[str, ...]] = {
    "white": (),
    "black": (),
    "gray": ("axis", "bit"),
    "complementary": ("axis", "period_px"),
    "phase": ("axis", "period_px", "step", "steps"),
    "line": ("axis", "period_px", "step", "steps"),
}
_MAY = {"gray": ("inverse", "xor_bit"), "complementary": ("inverse",)}


class FrameSection(Settings):
    """One picture of the stack."""

    file: Path = Field(description="The picture, relative to this file.")
    kind: Literal["white", "black", "gray", "complementary", "phase", "line"] = Field(
        description="The pattern that the projector shows."
    )
    axis: Axis | None = Field(
        default=None, description="The projector axis that the frame codes: column or row."
    )
    bit: int | None = Field(
        default=None,
        ge=0,
        le=23,
        description="The number of the bit of a Gray code; 0 is the finest bit.",
    )
    inverse: bool = Field(default=False, description="Whether dark and bright are swapped.")
    xor_bit: int | None = Field(
        default=None,
        ge=0,
        le=23,
        description="The Gray bit with which this bit is combined by XOR.",
    )
    period_px: float | None = Field(default=None, ge=2, description="Projector pixels per period.")
    step: float | None = Field(
        default=None,
        ge=0,
        description="The number of the phase step, counted from 0. It is a "
        "fraction if the cosine starts between two steps.",
    )
    steps: int | None = Field(default=None, ge=3, description="The number of phase steps.")

    @model_validator(mode="after")
    def _says_what_its_kind_needs(self) -> "FrameSection":
        must = _MUST[self.kind]
        for key in must:
            if getattr(self, key) is None:
                raise ValueError(f"a {self.kind} frame needs {key}: add it")
        allowed = ("file", "kind", *must, *_MAY.get(self.kind, ()))
        for key in self.model_fields_set.difference(allowed):
            if getattr(self, key) not in (None, False):
                raise ValueError(f"a {self.kind} frame has no {key}: remove it")
        self.frame()
        return self

    def frame(self) -> Frame:
        """Return the frame, without its file."""
        return Frame(
            kind=self.kind,
            axis=self.axis,
            bit=-1 if self.bit is None else self.bit,
            inverse=self.inverse,
            xor_bit=-1 if self.xor_bit is None else self.xor_bit,
            period_px=0.0 if self.period_px is None else self.period_px,
            step=_whole(self.step or 0.0),
            steps=0 if self.steps is None else self.steps,
        )


def _whole(number: float) -> int | float:
    return int(number) if number == int(number) else number


class ProjectorSection(Settings):
    """Size of the projector's picture."""

    width_px: int = Field(ge=2, le=65535, description="The width in pixels.")
    height_px: int = Field(ge=2, le=65535, description="The height in pixels.")


class OffsetSection(Settings):
    """Position of code 0 on the projector."""

    column: float = Field(default=0.0, description="The projector column of code 0, in pixels.")
    row: float = Field(default=0.0, description="The projector row of code 0, in pixels.")


class StrideSection(Settings):
    """Projector pixels per coded value."""

    column: Positive | None = Field(
        default=None,
        description="Projector pixels per coded value. Without this key, it is 1 or the "
        "period of a phase code.",
    )
    row: Positive | None = Field(
        default=None,
        description="Projector pixels per coded value. Without this key, it is 1 or the "
        "period of a phase code.",
    )


class LevelsSection(Settings):
    """Known properties of the camera (EMVA 1288); the others are measured in the stack."""

    offset_dn: float | None = Field(
        default=None, ge=0, description="The stored value without light."
    )
    saturation_dn: Positive | None = Field(
        default=None, description="The lowest stored value that counts as saturated."
    )
    read_noise_dn: float | None = Field(
        default=None, ge=0, description="The standard deviation of the noise in the dark."
    )
    gain_dn_per_e: float | None = Field(
        default=None, ge=0, description="Digital numbers per electron."
    )


DecodeSection = section_of(
    DecodeSpec,
    "DecodeSection",
    module=__name__,
    about="The conditions under which a pixel is decoded.",
    base=Settings,
    more={
        "max_epipolar_px": (
            Level | None,
            Field(
                default=None,
                description="Largest distance from the epipolar line in projector pixels; 0 "
                "switches the test off. Without this key, it is 5 times the "
                "median distance, but at least 2.",
            ),
        )
    },
)


class StackDescription(Settings):
    """The description of a stack, with the frame that each picture shows."""

    projector: ProjectorSection
    frames: tuple[FrameSection, ...] = Field(min_length=1, description="The pictures in order.")
    offset_px: OffsetSection = OffsetSection()
    stride_px: StrideSection = StrideSection()
    levels: LevelsSection = LevelsSection()
    decode: Annotated[Settings, read_as(DecodeSection)] = DecodeSection()
    rig: Path | None = Field(
        default=None, description="The rig file of the scanner, relative to this file."
    )

    def decode_spec(self) -> tuple[DecodeSpec, float | None]:
        """Return the conditions of decoding, and `max_epipolar_px` or None if it is not stated."""
        settings = self.decode.model_dump()
        limit_px = settings.pop("max_epipolar_px")
        return DecodeSpec(**settings), limit_px

    @model_validator(mode="after")
    def _shows_each_frame_once(self) -> "StackDescription":
        file_of: dict[Frame, Path] = {}
        for section in self.frames:
            frame = section.frame()
            if frame in file_of:
                both = f"{file_of[frame]} and {section.file}"
                raise ValueError(f"{both} are both {frame.name}: give each frame once")
            file_of[frame] = section.file
        files = [section.file for section in self.frames]
        twice = [file for file in files if files.count(file) > 1]
        if twice:
            names = " and ".join(s.frame().name for s in self.frames if s.file == twice[0])
            raise ValueError(f"{twice[0]} is given as {names}: give each file once")
        return self


def read_description(path: Path) -> StackDescription:
    """Read and check a stack file, but not its pictures.

    Raises:
        ConfigError: a value is wrong; the message names the file, the key and the remedy.
    """
    return read_settings(path, StackDescription)


def stack_scanner(path: Path) -> Scanner | None:
    """Return the scanner in the rig file that a stack file names; None if it names none.

    Raises:
        ConfigError: the stack file or the rig file has a wrong value.
    """
    own = read_description(path).rig
    return None if own is None else load_scanner(path.parent / own)


def describe_code(code: Code, files: Sequence[str]) -> str:
    """Return the text of a stack file for a code and the names of its pictures, in order."""
    return _as_yaml(_code_section(code, files))


def describe_stack(scanner: Scanner, files: Sequence[str], *, rig: str) -> str:
    """Return the text of a stack file that decodes pictures as the scanner decodes them.

    It states sensor levels and thresholds, so that nothing is measured in the pictures.

    Args:
        files: one name per frame of the scanner's code, in order.
        rig: name of the rig file in the same folder, which has the filters.
    """
    levels, decode = levels_of(scanner.sensor), scanner.decode
    content = _code_section(scanner.light_code(), files) | {
        "levels": {
            "offset_dn": float(levels.offset_dn),
            "saturation_dn": float(levels.saturation_dn),
            "read_noise_dn": float(scanner.sensor.gain_dn_per_e * scanner.sensor.read_noise_e),
            "gain_dn_per_e": float(levels.slope_dn),
        },
        "decode": {
            "min_contrast": float(decode.min_contrast),
            "min_sigmas": float(decode.min_sigmas),
            "doubt": float(decode.doubt),
            "fine_bits": int(decode.fine_bits),
            "settling_votes": int(decode.settling_votes),
            "min_visibility": float(decode.min_visibility),
            "max_epipolar_px": float(decode.max_epipolar_px),
            "max_p_wrong": float(decode.max_p_wrong),
        },
        "rig": rig,
    }
    return _as_yaml(content)


def describe_frames(code: Code, files: Sequence[str]) -> list[dict[str, Any]]:
    """Return the entries of a stack file that describe the pictures."""
    frames = []
    for frame, file in zip(code.frames, files, strict=True):
        entry: dict[str, Any] = {"file": file, "kind": frame.kind}
        facts = {
            "axis": frame.axis,
            "bit": frame.bit if frame.kind == "gray" else None,
            "inverse": frame.inverse or None,
            "xor_bit": frame.xor_bit if frame.xor_bit >= 0 else None,
            "period_px": frame.period_px or None,
            "step": frame.step if frame.steps else None,
            "steps": frame.steps or None,
        }
        frames.append(entry | {key: value for key, value in facts.items() if value is not None})
    return frames


def _code_section(code: Code, files: Sequence[str]) -> dict[str, Any]:
    return {
        "projector": {"width_px": code.width_px, "height_px": code.height_px},
        "frames": describe_frames(code, files),
        "offset_px": dict(zip(AXES, map(float, code.offset_px), strict=True)),
        "stride_px": dict(zip(AXES, map(float, code.stride_px), strict=True)),
    }


def _as_yaml(content: dict[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)


def code_of(description: StackDescription, path: Path) -> Code:
    """Return the code of the described frames.

    Raises:
        ConfigError: the frames do not make a code.
    """
    try:
        return Code(
            width_px=description.projector.width_px,
            height_px=description.projector.height_px,
            frames=tuple(section.frame() for section in description.frames),
            offset_px=(description.offset_px.column, description.offset_px.row),
            stride_px=(_stride_px(description, "column"), _stride_px(description, "row")),
        )
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def _stride_px(description: StackDescription, axis: Axis) -> float:
    """Return the stated stride; without one, the period if Gray bits count periods, or else 1."""
    stated = (description.stride_px.column, description.stride_px.row)[AXES.index(axis)]
    if stated is not None:
        return stated
    frames = [section.frame() for section in description.frames if section.axis == axis]
    bits = [frame.bit for frame in frames if frame.kind == "gray"]
    period_px = next((f.period_px for f in frames if f.kind == "complementary"), None)
    size_px = {"column": description.projector.width_px, "row": description.projector.height_px}
    if period_px is None or not bits or 2 ** (max(bits) + 1) >= size_px[axis]:
        return 1.0
    return period_px
