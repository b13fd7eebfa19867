"""The observations of a stack of pictures, checked for faults that would spoil a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ...base import array_types as arrays
from ...base.errors import ConfigError, GraycastError
from ...base.public_value import public_value
from ...camera.decode import FilterSpec, Mark, Reason, filter_depth
from ...camera.scanner import Scanner
from ...camera.stack import StackResult, decode_stack, stack_scanner
from ...dataset.files.safe_reading import Unreadable, read_mask
from ...dataset.write.raw import EXPOSURE, read_capture
from .fitting import scale_of
from .mottle import MottleFit, fit_mottle
from .normals import smooth_normals
from .observing import Reflections, observe
from .saturated import continue_planes

MOST_SATURATED = 0.5  # A surface with a larger saturated share is refused.
WITHOUT_EDGES = FilterSpec(edge_px=1.0)  # Pixels at edges would join the surfaces of two parts.
LEAST_MEASURED = 0.3  # A rig is refused if a smaller share of the decoded pixels has depth.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialScan:
    """A decoded stack, its scanner, and the relative exposure of its pixels.

    `surface_m` is depth that saturated areas have as well, see `saturated.continue_planes`.
    """

    path: Path
    result: StackResult
    scanner: Scanner
    surface_m: arrays.FloatArray_h_w
    exposure: arrays.FloatArray_h_w | float

    def observations(self, mask: arrays.BoolArray_h_w | None = None) -> Reflections:
        """Return the observations of the pixels in a mask; None is all pixels.

        A saturated pixel counts as at least as bright as the range, if its surface is known.
        Without a mask, pixels at depth steps and holes are left out.

        Raises:
            GraycastError: the mask has another size, a large part of the surface is saturated, or
                the code cannot separate direct light.
        """
        codes = self.result.codes
        shape = codes.reason.shape
        saturated = codes.reason == Reason.SATURATED
        inside = mask
        if inside is None:
            assert self.result.depth is not None
            apart = filter_depth(self.result.depth, WITHOUT_EDGES, self.scanner.rig)
            inside = np.isfinite(apart.depth_m) | saturated
        if inside.shape != shape:
            raise GraycastError(
                f"a mask has {inside.shape[1]} x {inside.shape[0]} px, and the pictures of "
                f"{self.path} have {shape[1]} x {shape[0]} px: give masks of the pictures"
            )
        if codes.mark is not None:
            saturated |= (codes.mark & Mark.CLIPPED) > 0
        lit = inside & (codes.reason != Reason.SHADOW)
        share = float(saturated[lit].mean()) if lit.any() else 0.0
        if share > MOST_SATURATED:
            raise GraycastError(
                f"{self.path}: {share:.0%} of the lit pixels of the surface are saturated, which "
                "hides its highlights: take a shorter exposure"
            )
        direct, indirect = self._light()
        levels, decoded = self.result.levels.levels, inside & (codes.reason == Reason.DECODED)
        bright = codes.reason == Reason.SATURATED
        if decoded.any():
            white = np.maximum((direct + indirect)[decoded], 1e-9)
            direct[bright] = np.median(direct[decoded] / white) * levels.range_dn
        observations = observe(
            self.scanner.rig,
            codes,
            self.surface_m,
            direct,
            levels,
            mask=inside,
            exposure=self.exposure,
        )
        if mask is None or not mask.any():
            return observations
        return replace(
            observations,
            dark_share=float(1 - lit[mask].mean()),
            saturated_share=float(saturated[mask].mean()),
        )

    def _light(self) -> tuple[arrays.FloatArray_h_w, arrays.FloatArray_h_w]:
        """Return direct and global light.

        Raises:
            GraycastError: the code cannot separate direct light.
        """
        if self.result.light is None:
            raise GraycastError(
                f"{self.path}: the code cannot separate the projector's direct light, which needs "
                "phases, or narrow stripes with their inverses or with white and black frames: "
                "scan with such a code"
            )
        direct, indirect = (light.astype(np.float64) for light in self.result.light)
        return direct, indirect

    def scale(self, white: arrays.BoolArray_h_w, reflectance: float) -> float:
        """Return the light of a BSDF of 1 per steradian, which `fit_material` can use.

        Args:
            white: mask of a matt surface whose reflectance is known.
            reflectance: its reflectance at the projector's wavelength.

        Raises:
            GraycastError: the mask does not fit the scan, or has too few decoded pixels.
        """
        return scale_of(self.observations(white), reflectance)

    def mottle(self, mask: arrays.BoolArray_h_w, *, seed: int) -> MottleFit:
        """Fit the mottle of the decoded pixels in a mask that have a normal.

        Raises:
            GraycastError: the light is that of a laser, the code cannot separate direct light, or
                the pixels are too few.
        """
        if self.scanner.rig.speckle_contrast:
            raise GraycastError("the speckle of the laser looks like mottle")
        result, camera = self.result, self.scanner.rig.camera
        direct = self._light()[0]
        normals = smooth_normals(camera, self.surface_m, mask)
        use = mask & np.isfinite(normals.sigma_rad) & (result.codes.reason == Reason.DECODED)
        pixel_m = float(np.median(self.surface_m[use])) / camera.fx_px if use.any() else 1.0
        return fit_mottle(direct, use, result.levels.levels, pixel_m=pixel_m, seed=seed)

    def saturated_pixels(self, mask: arrays.BoolArray_h_w | None = None) -> int:
        """Return the number of saturated pixels in a mask that are on no known plane."""
        lost = (self.result.codes.reason == Reason.SATURATED) & np.isnan(self.surface_m)
        return int((lost if mask is None else lost & mask).sum())


def open_scan(path: Path | str, scanner: Scanner | None = None) -> MaterialScan:
    """Decode a stack for the fit of materials.

    Args:
        path: a stack file, or a folder that holds a `stack.yaml`, such as `frames` of a scene.
        scanner: scanner of the stack; None takes the rig that the stack file names.

    Raises:
        GraycastError: the stack cannot be decoded, or the rig does not belong to the stack.
    """
    path = Path(path)
    stack = path / "stack.yaml" if path.is_dir() else path
    if scanner is None:
        scanner = stack_scanner(stack)
    if scanner is None:
        raise ConfigError(f"{stack}: names no rig, which a material needs: give --rig")
    result = decode_stack(stack, scanner.rig, filters=scanner.filters)
    assert result.depth is not None
    decoded = result.codes.reason == Reason.DECODED
    share = float(np.isfinite(result.depth.depth_m[decoded]).mean())
    if share < LEAST_MEASURED:
        raise GraycastError(
            f"{stack}: with rig {scanner.rig.name}, only {share:.0%} of the decoded pixels have a "
            "depth: give the rig of this scan, or scan within its working range"
        )
    depth_m = result.depth.depth_m.astype(np.float64)
    return MaterialScan(
        path=stack,
        result=result,
        scanner=scanner,
        surface_m=continue_planes(depth_m, result.codes.reason == Reason.SATURATED),
        exposure=_exposure(stack),
    )


def read_masks(paths: Sequence[Path]) -> Bool[np.ndarray, "h w"]:
    """Return the union of masks that have the same size.

    Raises:
        GraycastError: a file is no mask, or the masks differ in size or have no pixel.
    """
    union = None
    for path in paths:
        try:
            mask = read_mask(path)
        except Unreadable as error:
            raise GraycastError(f"{path}: {error}") from error
        if union is not None and mask.shape != union.shape:
            raise GraycastError(f"{path}: has another size than {paths[0]}: give masks of one scan")
        union = mask if union is None else union | mask
    if union is None or not union.any():
        raise GraycastError(f"{paths[0]}: no pixel is inside the mask: mark the surface with 255")
    return union


def _exposure(stack: Path) -> Float[np.ndarray, "h w"] | float:
    """Return each pixel's exposure relative to the longest; a dataset's scene may have several.

    Raises:
        GraycastError: the scene's files are damaged.
    """
    if not (stack.parent / EXPOSURE).exists():
        return 1.0
    try:
        raw = read_capture(stack.parent.parent)
    except Unreadable as error:
        raise GraycastError(f"{stack.parent.parent}: {error}") from error
    if raw is None or raw.capture is None:
        raise GraycastError(
            f"{stack.parent / EXPOSURE}: the exposure times are in the scene's manifest, which is "
            "missing: keep the pictures in the folder of their scene"
        )
    times_s = np.asarray(raw.capture.exposure_s, dtype=np.float64)
    return times_s / times_s.max()
