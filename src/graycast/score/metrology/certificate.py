"""Results of a certificate as plain numbers with units, ready for JSON."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """The artefacts to measure and the quality of the rendered light.

    The artefacts are `distances` facing planes from near to far, planes tilted by `tilts_deg` about
    the baseline, `spheres` for probing, and the ball bar in its first `bars` positions. All are
    perfect diffusers with the reflectance `albedo`. Light is traced with `samples` paths per pixel
    and `depth` vertices per path; a depth of 1 means direct light only.
    """

    distances: int = 5
    tilts_deg: tuple[float, ...] = (15.0, 30.0, 45.0, 60.0)
    spheres: int = 10
    bars: int = 7
    captures: int = 8
    samples: int = 16
    depth: int = 1
    albedo: float = 0.8

    def __post_init__(self) -> None:
        if self.distances < 3 or self.distances % 2 == 0:
            raise ValueError(
                f"distances is {self.distances}; give an odd number of at least 3, for near, "
                "middle and far"
            )
        if not all(0 < tilt < 80 for tilt in self.tilts_deg):
            raise ValueError(
                f"tilts_deg are {self.tilts_deg}; give angles greater than 0 and less than 80"
            )
        if not 1 <= self.spheres <= 10:
            raise ValueError(f"spheres is {self.spheres}; give 1 to 10")
        if not 1 <= self.bars <= 7:
            raise ValueError(f"bars is {self.bars}; give 1 to 7")
        if self.captures < 2:
            raise ValueError(f"captures is {self.captures}; give at least 2, which the noise needs")
        if not 0 < self.albedo <= 1:
            raise ValueError(f"albedo is {self.albedo}; give a value greater than 0 and at most 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneResult:
    """Figures of one plane in one pose.

    `flatness_m` is the range of signed distances from the best-fit plane, `std_m` their standard
    deviation, and `offset_m` the median of measured minus true depth, all over the common field.
    The other figures use the middle of the field. `noise_m` is the standard deviation of depth from
    shot to shot (NaN for a single capture). `error_m` is the standard deviation of measured minus
    true depth over the pixels of one shot. Unlike `noise_m`, it contains fixed errors, such as
    those from a device's raster, and is comparable with the scanner's `sigma_m`. `exposures_s` are
    the exposure times that are merged.
    """

    name: str
    z_m: float
    tilt_deg: float
    azimuth_deg: float
    flatness_m: float
    std_m: float
    offset_m: float
    points: int
    dropped: int
    decoded_share: float
    noise_m: float
    error_m: float
    sigma_m: float
    spacing_m: float
    exposures_s: tuple[float, ...]
    modulation: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbingResult:
    """Figures of one sphere: PF is `form_m`, PS is `size_m` (fitted minus nominal diameter)."""

    centre_m: tuple[float, float, float]
    form_m: float
    size_m: float
    std_m: float
    centre_error_m: float
    points: int
    dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacingResult:
    """Figures of the ball bar in one position: SD is `error_m`, measured minus nominal distance."""

    name: str
    ends_m: tuple[tuple[float, float, float], tuple[float, float, float]]
    error_m: float
    points: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class BlurResult:
    """Radius of the blur disc of a point on the camera's axis, in pixels of each device.

    The radius is the closed form in `optics.blur_radius_px`.
    """

    z_m: float
    camera_px: float
    projector_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """Accuracy of a virtual scanner; the docs and `sheet` explain how each number is measured.

    `deviation_m` is the signed distance of the middle plane from its best fit, averaged over blocks
    of pixels; a plot shows it, and the JSON omits it.
    """

    rig: dict[str, Any]
    conditions: dict[str, Any]
    near_m: float
    far_m: float
    diagonal_m: float
    field_m: dict[str, tuple[float, float]]
    probing_diameter_m: float
    bar_length_m: float
    bar_diameter_m: float
    planes: tuple[PlaneResult, ...]
    probing: tuple[ProbingResult, ...]
    spacing: tuple[SpacingResult, ...]
    blur: tuple[BlurResult, ...]
    deviation_m: Float[np.ndarray, "h w"]
    seconds: float
    scenes: int

    def __post_init__(self) -> None:
        self.deviation_m.flags.writeable = False

    @property
    def facing(self) -> tuple[PlaneResult, ...]:
        """The facing planes, from near to far."""
        return tuple(plane for plane in self.planes if plane.tilt_deg == 0)

    @property
    def middle(self) -> PlaneResult:
        """The facing plane at the middle distance."""
        return self.facing[len(self.facing) // 2]

    @property
    def tilted(self) -> tuple[PlaneResult, ...]:
        """The facing plane at the middle distance, then the planes tilted about the baseline."""
        return self.middle, *(p for p in self.planes if p.name.startswith("tilted about baseline"))

    @property
    def summary(self) -> dict[str, float]:
        """Figures for a datasheet; errors are the largest over all positions, with their signs."""

        def worst(values: list[float]) -> float:
            return max(values, key=abs)

        return {
            "temporal_noise_m": self.middle.noise_m,
            "temporal_noise_near_m": self.facing[0].noise_m,
            "temporal_noise_far_m": self.facing[-1].noise_m,
            "flatness_error_m": worst([plane.flatness_m for plane in self.planes]),
            "plane_std_m": worst([plane.std_m for plane in self.planes]),
            "probing_form_m": worst([one.form_m for one in self.probing]),
            "probing_size_m": worst([one.size_m for one in self.probing]),
            "sphere_spacing_m": worst([one.error_m for one in self.spacing]),
            "point_spacing_near_m": self.facing[0].spacing_m,
            "point_spacing_m": self.middle.spacing_m,
            "point_spacing_far_m": self.facing[-1].spacing_m,
        }

    def record(self) -> dict[str, Any]:
        """Return all numbers as values for JSON, with None instead of NaN."""
        known = asdict(self)
        known.pop("deviation_m")
        return _without_nan({"summary": self.summary, **known})


def _without_nan(value: Any) -> Any:
    match value:
        case dict():
            return {key: _without_nan(item) for key, item in value.items()}
        case list() | tuple():
            return [_without_nan(item) for item in value]
        case float() if not math.isfinite(value):
            return None
        case np.generic():
            return _without_nan(value.item())
    return value
