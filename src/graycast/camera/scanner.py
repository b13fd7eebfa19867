"""A scanner: a rig with its code, sensor, exposure, filters and faults; preset scanners.

The functions `take` and `measure` together compute depth from light.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..base import array_types as arrays
from ..base.errors import ConfigError
from ..base.public_value import public_value
from ..base.settings import check_fields
from ..rendering import PathNoise, Radiance
from ..rig.former_names import current_name
from ..rig.optics import points
from ..rig.pair import BINNING, PRESETS, Rig, preset_rig
from ..rig.pattern import AXES, Code, CodeSpec
from ..rig.shelf import shelf_entry
from .decode import (
    CodeMap,
    DecodeSpec,
    DepthMap,
    FilterSpec,
    decode,
    filter_depth,
    levels_of,
    triangulate,
    triangulation_axis,
    without_doubt,
)
from .exposure import ExposureSpec, ExposureTimes, exposure_times
from .faults import FaultSpec, with_faults
from .light import SensorLight, camera_light
from .line_noise import with_line_noise
from .sensor import Capture, SensorSpec, expose, merge_exposures
from .sigma import (
    bend_m,
    light_path_px,
    line_noise_px,
    speckle_m,
    with_depth_term,
    with_position_term,
    with_ripple,
)
from .speckle import (
    PATCH_M,
    Speckle,
    draw_speckle,
    footprint_px,
    material_contrast,
    pixel_contrast,
    speckled,
    uneven,
)

APERTURE_SLACK = 0.05  # Relative difference allowed between camera.aperture_m and sensor.f_number.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Scanner:
    """All settings of a virtual scanner.

    `code` is a named code or, for this projector only, the user's own list of frames.
    """

    rig: Rig
    code: CodeSpec | Code = field(default_factory=CodeSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    exposure: ExposureSpec = field(default_factory=ExposureSpec)
    decode: DecodeSpec = field(default_factory=DecodeSpec)
    filters: FilterSpec = field(default_factory=FilterSpec)
    faults: FaultSpec = field(default_factory=FaultSpec)

    def __post_init__(self) -> None:
        check_fields(self)
        camera = self.rig.camera
        if camera.aperture_m > 0:
            f_number = camera.fx_px * self.sensor.pixel_pitch_m / camera.aperture_m
            if abs(self.sensor.f_number / f_number - 1) > APERTURE_SLACK:
                raise ValueError(
                    f"sensor.f_number is {self.sensor.f_number:g}, but camera.aperture_m "
                    f"{camera.aperture_m:g} with pixels of {self.sensor.pixel_pitch_m:g} m makes "
                    f"f/{f_number:.3g}: make both agree"
                )

    def light_code(self) -> Code:
        """Return the code for this rig's projector."""
        return self.code.code(self.rig.projector.width_px, self.rig.projector.height_px)

    def named_code(self) -> CodeSpec:
        """Return the code, which must have a name for files and for the fit of a twin.

        Raises:
            ConfigError: the code is a list of frames.
        """
        if isinstance(self.code, Code):
            raise ConfigError("the code is a list of frames: give a code that has a name")
        return self.code


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """One scan: pictures, projector positions and depth."""

    capture: Capture
    codes: CodeMap
    depth: DepthMap


def scan(scanner: Scanner, radiance: Radiance, *, seed: int) -> Scan:
    """Take the pictures of a scanner, and measure projector positions and depth in them."""
    capture = take(scanner, radiance, seed=seed)
    codes, depth = measure(scanner, capture, path_noise=radiance.path_noise)
    return Scan(capture=capture, codes=codes, depth=depth)


def take(
    scanner: Scanner,
    radiance: Radiance,
    *,
    seed: int,
    metered: arrays.BoolArray_h_w | None = None,
) -> Capture:
    """Return the stack of `take_exposures` for a still scene, with all exposures merged."""
    return merge_exposures(take_exposures(scanner, radiance, seed=seed, metered=metered))


def take_exposures(
    scanner: Scanner,
    radiance: Radiance,
    *,
    seed: int,
    metered: arrays.BoolArray_h_w | None = None,
    light_of: Callable[[ExposureTimes], Sequence[SensorLight]] | None = None,
) -> list[Capture]:
    """Return the measuring camera's stack of each exposure: one picture per pattern.

    All exposures are taken through the same optics, so they have the same speckle pattern.

    Args:
        metered: mask of the pixels from which `exposure.auto` chooses its times, like a user's
            region of interest; None means all pixels. Ignored without `exposure.auto`.
        light_of: returns the light of each exposure of a moving scene, of which `radiance` is the
            state that sets the exposure times; None: nothing moves.

    Raises:
        ValueError: the scene is dark, or its light is not finite.
    """
    still = SensorLight(*camera_light(radiance, scanner.rig))
    exposure = scanner.exposure
    white = still.stack[scanner.light_code().brightest] + still.background
    if exposure.auto and metered is not None:
        white = white[metered]
    times = exposure_times(white.ravel(), scanner.sensor, exposure)
    lights = [still] if light_of is None else [*light_of(times)]
    if scanner.rig.speckle_contrast:
        speckle = _speckle(scanner, radiance, seed)
        lights = [replace(light, stack=speckled(light.stack, speckle)) for light in lights]
    lights = lights * len(times.times_s) if light_of is None else lights
    seeds = np.random.SeedSequence(seed).generate_state(len(times.times_s), np.uint64)
    captures = []
    for light, time_s, own in zip(lights, times.times_s, seeds, strict=True):
        stack = _with_new_lines(scanner, radiance, light.stack, seed=int(own))
        capture = expose(stack, light.background, scanner.sensor, exposure_s=time_s, seed=int(own))
        captures.append(replace(capture, reference_s=times.reference_s))
    return captures


def _speckle(scanner: Scanner, radiance: Radiance, seed: int) -> Speckle:
    """Return the speckle of a scan, whose contrast depends on the surface at each pixel."""
    reflectance = radiance.albedo @ np.array(scanner.rig.band_weights, dtype=np.float32)
    contrast = _of_black(scanner) * material_contrast(reflectance, scanner.rig.speckle_volume)
    if scanner.rig.speckle_unevenness:
        contrast = uneven(
            contrast,
            scanner.rig.speckle_unevenness,
            patch_px=_in_picture_px(scanner.rig, PATCH_M),
            seed=seed,
        )
    return draw_speckle(contrast, scanner.sensor, seed=seed, side=_side(scanner))


def _with_new_lines(
    scanner: Scanner, radiance: Radiance, stack: Float[np.ndarray, "n h w"], *, seed: int
) -> Float[np.ndarray, "n h w"]:
    """Return the light of one exposure, with the errors that the projector's lines have in it."""
    share = scanner.rig.line_noise
    if not share:
        return stack
    if radiance.place_px is None:
        raise ValueError(
            f"rig {scanner.rig.name} has line_noise {share:g}, which needs the place in the "
            "projector's picture that lights each pixel: give a radiance with place_px, as the "
            "renderers make it, or set line_noise to 0"
        )
    axis = triangulation_axis(scanner.rig)
    place_px = radiance.place_px[AXES.index(axis)]
    length_px = _in_picture_px(scanner.rig, scanner.rig.line_noise_length_m)
    return with_line_noise(stack, place_px, share, axis=axis, length_px=length_px, seed=seed)


def scan_seconds(capture: Capture, *, readout_s: float) -> float:
    """Return the duration of a stack: each frame is exposed and read out once per exposure time.

    Leaves out: pauses between frames, and computing, which scanners do during the next scan.
    """
    return len(capture.frames) * (sum(capture.times_s) + len(capture.times_s) * readout_s)


def measure(
    scanner: Scanner,
    capture: Capture,
    *,
    path_noise: PathNoise | None,
    bends: bool = True,
) -> tuple[CodeMap, DepthMap]:
    """Decode simulated pictures to positions and depth, with the scanner's filters and faults.

    `sigma.TERMS` lists the terms of sigma. For real pictures, use `stack.decode_stack`.

    Args:
        path_noise: `path_noise` of the radiance from which the pictures were taken.
        bends: whether sigma has the term from bends of the surface.
    """
    rig, code = scanner.rig, scanner.light_code()
    codes, depth = decode_capture(scanner, capture, path_noise=path_noise)
    codes, depth = without_doubt(
        codes,
        depth,
        rig,
        capture.frames,
        code,
        levels_of(scanner.sensor),
        max_p_wrong=scanner.decode.max_p_wrong,
    )
    light_contrast = np.ones(depth.depth_m.shape, dtype=np.float32)
    if rig.speckle_contrast:
        own_reflectance = _effective_reflectance(scanner, capture, depth)
        light_contrast = material_contrast(own_reflectance, rig.speckle_volume)
        # Speckle shifts the centre of a black pixel's light by this distance (one sigma).
        off_px = footprint_px(scanner.sensor, side=_side(scanner)) * _of_black(scanner)
        off_map_px = np.float32(off_px) * light_contrast
        depth = with_depth_term(depth, speckle_m(depth, codes, rig, off_map_px))
    depth = with_faults(
        filter_depth(depth, scanner.filters, rig),
        scanner.faults,
        seed=scanner.sensor.fpn_seed,
        light_contrast=light_contrast,
    )
    return codes, with_depth_term(depth, bend_m(depth)) if bends else depth


def decode_capture(
    scanner: Scanner, capture: Capture, *, path_noise: PathNoise | None
) -> tuple[CodeMap, DepthMap]:
    """Return positions and depth as the code gives them, before any depth is refused or filtered.

    Args:
        path_noise: `path_noise` of the radiance from which the pictures were taken.
    """
    rig, code = scanner.rig, scanner.light_code()
    axis = triangulation_axis(rig)
    codes = decode(capture.frames, code, scanner.decode, levels_of(scanner.sensor))
    codes = with_ripple(codes, code)
    codes = with_position_term(codes, {axis: line_noise_px(code, axis, rig.line_noise)})
    if path_noise is not None:
        codes = with_position_term(codes, light_path_px(code, path_noise))
    return codes, triangulate(codes, rig, max_epipolar_px=scanner.decode.max_epipolar_px)


def _of_black(scanner: Scanner) -> float:
    """Return the speckle contrast of a pixel that sees a black surface."""
    return scanner.rig.speckle_contrast * pixel_contrast(scanner.sensor, side=_side(scanner))


def _in_picture_px(rig: Rig, length_m: float) -> float:
    """Return the size in pixels of a length on a facing surface in the middle of the range."""
    return rig.camera.fx_px * length_m / ((rig.near_m + rig.far_m) / 2)


def _side(scanner: Scanner) -> float:
    """Return the side of the active square of a camera pixel [px]."""
    return math.sqrt(scanner.rig.camera.fill_factor)


def _effective_reflectance(
    scanner: Scanner, capture: Capture, depth: DepthMap
) -> Float[np.ndarray, "h w"]:
    """Return the diffuse reflectance that would explain each pixel's brightness; 0 without depth.

    A facing surface at distance d reflects the radiance `R I / (pi d^2)`. A slanted or dimly lit
    surface has a higher reflectance than this estimate, so its speckle is overestimated.
    """
    rig, sensor = scanner.rig, scanner.sensor
    # Use the darkest and brightest frames, because the modulation of thin lines would be too small.
    span_dn = capture.frames.max(axis=0).astype(np.float32) - capture.frames.min(axis=0)
    electrons = span_dn / sensor.gain_dn_per_e
    light = electrons / (sensor.responsivity * capture.exposure_s)
    point = points(rig.camera, depth.depth_m)
    distance2_m2 = np.square(point - rig.T_cam_proj[:3, 3]).sum(axis=-1)
    return np.nan_to_num(np.pi * distance2_m2 * light / rig.intensity_w_sr)


# --- presets -----------------------------------------------------------------------------------


def preset(name: str, resolution: str = "low") -> Scanner:
    """Return a preset scanner.

    `paper` is the scanner of K. Bai et al. 2024, with a plain Gray code and no filter. The others
    project a phase code on both axes, remove depth that is wrong with a probability over 0.05, and
    flying pixels, and smooth the depth. docs/measurements/materials.md has the shares of wrong
    depth on eight materials. Scanners with a laser have a slight blur of the line, speckle, and the
    faults of a real device.

    Args:
        name: one of `rig.pair.PRESETS`, or a former name of a preset.
        resolution: 'small', 'low' or 'full', see `rig.pair.preset_rig`.

    Raises:
        ValueError: there is no such preset or resolution.
    """
    name = current_name(name)
    rig = preset_rig(name, resolution)
    if name == "paper":
        return Scanner(rig=rig, decode=DecodeSpec(max_epipolar_px=0.0))
    entry = shelf_entry(name)
    pitch_m = entry.pixel_pitch_m * BINNING[resolution]
    # Without a stated focus, blur is equal at both ends of the range.
    focus_m = entry.focus_m or 2 / (1 / rig.near_m + 1 / rig.far_m)
    rig = replace(
        rig,
        camera=replace(
            rig.camera,
            aperture_m=rig.camera.fx_px * pitch_m / entry.f_number,
            focus_m=focus_m,
            natural_vignetting=True,
        ),
        projector=replace(
            rig.projector,
            psf_px=_LASER_PSF_PX if entry.laser else _DLP_PSF_PX,
            natural_vignetting=True,
        ),
    )
    if entry.laser:
        rig = replace(
            rig,
            speckle_contrast=_PHOXI_SPECKLE,
            speckle_volume=_PHOXI_VOLUME,
            line_noise=_PHOXI_LINE_NOISE,
            line_noise_length_m=_PHOXI_LINE_M,
        )
    return Scanner(
        rig=rig,
        code=CodeSpec(codec="gray_phase", period_px=48.0, fine_period_px=16.0, steps=4),
        exposure=ExposureSpec(factors=(1.0, 4.0)),
        sensor=SensorSpec(
            pixel_pitch_m=pitch_m, f_number=entry.f_number, wavelength_m=entry.wavelength_m
        ),
        decode=DecodeSpec(
            min_contrast=0.002, min_sigmas=3.0, doubt=0.0, max_epipolar_px=0.0, max_p_wrong=0.05
        ),
        filters=FilterSpec(flying_angle_deg=75.0, smoothing_px=0.55),
        faults=FaultSpec(raster_px=_PHOXI_RASTER_PX[resolution] if entry.laser else 0.0),
    )


_LASER_PSF_PX, _DLP_PSF_PX = 1.0, 0.5  # Our choice: pixels of micromirrors have sharper borders.
# The noise on black, white and slopes in five scans gives these (docs/measurements/rigs.md).
_PHOXI_SPECKLE, _PHOXI_VOLUME = 0.5, 5.0
# In the middle of its range, at 1.51 m, like-phoxi-l then has the temporal noise that the maker
# states without a distance (docs/measurements/accuracy.md); at 1.24 m it has two thirds of that.
# With this short length the noise is independent between pixels, like most noise of those scans.
_PHOXI_LINE_NOISE, _PHOXI_LINE_M = 0.041, 0.001
# On the surface this is 0.2 mm, as in small maps of a real device; for full maps it is unknown.
_PHOXI_RASTER_PX = {"small": 0.15, "low": 0.3, "full": 0.3}

__all__ = [
    "PRESETS",
    "ExposureSpec",
    "Scan",
    "Scanner",
    "measure",
    "preset",
    "scan",
    "scan_seconds",
    "take",
]
