"""Contents of the shelf's files, and the reasons why other scanners are not on the shelf."""

import math
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from ...base.errors import ConfigError
from ...base.frames import axis_rotation, inverse, rigid
from ...base.settings import Finite, Positive, PositiveSpan, Settings, check_settings, parse_yaml
from ..optics import Optics

SHELF = (
    *("like-phoxi-s", "like-phoxi-m", "like-phoxi-l", "like-phoxi-xs", "like-phoxi-xl"),
    *("like-zivid-2-m70", "like-zivid-2-l100", "like-zivid-2plus-m60", "like-zivid-2plus-mr60"),
    *("like-zivid-2plus-m130", "like-zivid-2plus-mr130", "like-zivid-2plus-l110"),
    *("like-zivid-2plus-lr110", "like-mech-eye-nano", "like-mech-eye-pro-s"),
    *("like-mech-eye-pro-m", "lab-lightcrafter-4500", "office-projector"),
)
MEASURED = "measured.yaml"
NAMES = ("paper", *SHELF)  # The paper's rig is like-phoxi-m with white light.
_OTHER_PRINCIPLES: Mapping[str, tuple[str, ...]] = {
    "stereo of two cameras": (
        *("realsense", "d405", "d415", "d435", "d455", "ensenso", "orbbec", "gemini", "zed", "oak"),
        "visard",
    ),
    "time of flight": (*("kinect", "femto", "helios", "l515", "visionary", "blaze", "cubeeye"),),
    "a speckle pattern that never changes": ("astra", "primesense", "xtion"),
}
_TOO_LITTLE_PUBLIC = ("motioncam", "cognex", "keyence")


class DeviceSection(Settings):
    """A camera or a projector; by default it has square pixels and a centred principal point."""

    size_px: tuple[int, int]
    fx_px: Positive | None = None
    fy_px: Positive | None = None  # None: equal to fx_px
    field_deg: tuple[Positive, Positive] | None = None
    cy_px: Finite | None = None  # None: in the middle

    @model_validator(mode="after")
    def _one_of_two(self) -> "DeviceSection":
        if (self.fx_px is None) == (self.field_deg is None):
            raise ValueError("give either fx_px or field_deg")
        return self

    def optics(self, binning: int = 1) -> Optics:
        """Return pinhole optics in which `binning` x `binning` pixels are summed to one pixel.

        Positions are relative to pixel centres, so `c + 0.5` becomes `(c + 0.5) / binning`.
        """
        width_px, height_px = (side // binning for side in self.size_px)
        if self.field_deg is not None:
            half_x, half_y = (math.tan(angle / 2) for angle in np.radians(self.field_deg))
            fx_px, fy_px = width_px / 2 / half_x, height_px / 2 / half_y
        else:
            assert self.fx_px is not None  # `_one_of_two` ensures this.
            fx_px = self.fx_px / binning
            fy_px = fx_px if self.fy_px is None else self.fy_px / binning
        middle_px = (height_px - 1) / 2
        return Optics(
            width_px=width_px,
            height_px=height_px,
            fx_px=fx_px,
            fy_px=fy_px,
            cx_px=(width_px - 1) / 2,
            cy_px=middle_px if self.cy_px is None else (self.cy_px + 0.5) / binning - 0.5,
        )


class FieldClaim(Settings):
    """Width and height of the field of view that a maker states for a distance."""

    at_m: Positive
    size_m: tuple[Positive, Positive]


class FigureClaim(Settings):
    """A length, such as a noise, that a maker states for a distance."""

    at_m: Positive
    value_m: Positive


class Claims(Settings):
    """The figures that a maker states for its device; None for a figure that we do not know."""

    fields: tuple[FieldClaim, ...] = ()
    noise: FigureClaim | None = None  # temporal noise, point precision or Z repeatability, 1 sigma
    spacing: FigureClaim | None = None  # distance between neighbouring points
    trueness: FigureClaim | None = None
    trueness_share: Positive | None = None  # relative to the measured length
    capture_s: PositiveSpan | None = None


class ShelfEntry(Settings):
    """A scanner of the shelf.

    The relative pose is given in one of two ways: a baseline along x and the toe-in of each device,
    or the projector's pose in the camera frame, with its rotation about x first and then about y.
    """

    likeness: str
    camera: DeviceSection
    projector: DeviceSection
    pixel_pitch_m: Positive
    f_number: Positive
    baseline_m: Positive | None = None
    toe_in_deg: tuple[float, float] | None = None  # camera, projector
    t_cam_proj_m: tuple[float, float, float] | None = None
    turn_cam_proj_rad: tuple[float, float] | None = None
    near_m: Positive
    far_m: Positive
    focus_m: Positive | None = None  # None: blur is equal at both ends of the range
    laser: bool = False
    light: Literal["red", "white", "blue"]
    wavelength_m: Annotated[float, Field(gt=0, lt=1e-5)]
    claims: Claims = Claims()

    @property
    def band_weights(self) -> tuple[float, float, float]:
        """Shares of red, green and blue in the projector's light."""
        return {"red": (1.0, 0.0, 0.0), "white": (1 / 3,) * 3, "blue": (0.0, 0.0, 1.0)}[self.light]

    @property
    def T_cam_proj(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the projector in camera coordinates: maps projector to camera points [m]."""
        if self.t_cam_proj_m is not None and self.turn_cam_proj_rad is not None:
            x_rad, y_rad = self.turn_cam_proj_rad
            turn = axis_rotation("y", y_rad) @ axis_rotation("x", x_rad)
            return rigid(turn, np.array(self.t_cam_proj_m))
        assert self.baseline_m is not None and self.toe_in_deg is not None
        camera_rad, projector_rad = (math.radians(angle) for angle in self.toe_in_deg)
        half_m = self.baseline_m / 2
        T_rig_cam = rigid(axis_rotation("y", camera_rad), np.array([-half_m, 0.0, 0.0]))
        T_rig_proj = rigid(axis_rotation("y", -projector_rad), np.array([half_m, 0.0, 0.0]))
        return inverse(T_rig_cam) @ T_rig_proj


class ShelfFigures(Settings):
    """Figures that `python -m benchmarks shelf` measured for one scanner at the distances `z_m`.

    They come from `graycast rig certify` with a small scope.

    On planes that face the scanner, `noise_m` is the temporal standard deviation of depth,
    `spacing_m` the distance between neighbouring points, and `plane_std_m` the standard deviation
    from the best-fit plane. `length_error` is the relative error of a ball bar's length.
    """

    z_m: tuple[Positive, ...]
    noise_m: tuple[Positive, ...]
    spacing_m: tuple[Positive, ...]
    plane_std_m: tuple[Positive, ...]
    length_error: float
    capture_s: Positive


class _Table(Settings):
    origin: str
    resolution: str
    scanners: dict[str, ShelfFigures]


@cache
def shelf_entry(name: str) -> ShelfEntry:
    """Load the file of a scanner whose name is in `SHELF`, with the keys of its base."""
    content = dict(_content(f"{name}.yaml"))
    base = base_of(name, content.pop("base", None))
    return check_settings(
        content if base is None else {**_content(f"{base}.yaml"), **content},
        ShelfEntry,
        Path(f"{name}.yaml"),
    )


def base_of(name: str, base: str | None) -> str | None:
    """Check the base that the file of `name` states, and return it; None for a file without a base.

    Raises:
        ConfigError: the base is no scanner of the shelf, or has a base of its own.
    """
    if base is None or (base in SHELF and "base" not in _content(f"{base}.yaml")):
        return base
    raise ConfigError(
        f"{name}.yaml: base is {base!r}: name a scanner of the shelf whose file has no base"
    )


@cache
def measured() -> _Table:
    """Load the stored table of figures, with its resolution and the command that made it."""
    return check_settings(_content(MEASURED), _Table, Path(MEASURED))


def _content(file: str) -> Mapping[str, Any]:
    return parse_yaml(files(__package__).joinpath(file).read_text(encoding="utf-8"), Path(file))


def no_rig(name: str, folder: Path | None = None) -> str:
    """Return the error message for a name that is neither in `NAMES` nor a file of the folder."""
    words = re.split(r"[^a-z0-9]+", name.lower())
    for principle, others in _OTHER_PRINCIPLES.items():
        if any(word.startswith(others) for word in words):
            return (
                f"no rig {name!r}: it measures by {principle}, and Graycast simulates only coded "
                "light of a projector"
            )
    if any(word.startswith(_TOO_LITTLE_PUBLIC) for word in words):
        return (
            f"no rig {name!r}: too little of it is public. docs/reference/shelf.md lists what is "
            "missing; write a rig file of your own"
        )
    files = "" if folder is None else f", or name a file in {folder}"
    return f"no rig {name!r}: choose one of {', '.join(NAMES)}{files}"
