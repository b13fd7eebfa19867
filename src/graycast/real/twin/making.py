"""Construction of a twin from real scans and the configuration of a cell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...cell.resolve import Cell, open_cell_renderer
from ...rig.pattern import CodeSpec
from ...world.scene import bin_of
from ..realism import DepthScan, TwoSample, two_sample_test
from ..realism.depth_steps import count_steps
from ..realism.patches import find_floor
from ..realism.two_sample import require_sklearn
from .parameters import (
    BIN_COLOR,
    BIN_GLOSS,
    BIN_ROUGHNESS,
    PARAMETERS,
    ROUGHER,
    Parameter,
    candidate_codes,
)
from .restaging import restage
from .rows import figures_of
from .searching import Fit, scans_of, search
from .stage import LitScene, light_scenes, missing_places

LEAST_SCANS = 3
LEAST_ASIDE = 2  # Cross-validation of the classifier leaves out one scan at a time.
_SMOOTHEST = 0.1  # A smoother coat reflects the projector only in single pixels.
_LEAST_JUMPS = 20  # Fewer depth steps per map do not show which side is in shadow.
_MOST_SHARE = 0.25  # On a shadow side, steps are at most this share of the other side's.
COATS = (-ROUGHER, 0.0, ROUGHER)  # changes of roughness for which the coat is rendered


@dataclass(frozen=True, slots=True, kw_only=True)
class Twin:
    """Result of a fit, with example scans and the classifier's results.

    `examples` has a real scan, and scans of its scene by the configured scanner and by the twin.
    `classified` has the tests 'before' and 'after' the search, and on scans 'kept aside' from it.
    """

    fit: Fit
    scans: int  # number of fitted scans
    examples: tuple[DepthScan, DepthScan, DepthScan]
    classified: dict[str, TwoSample]


def make_twin(
    real: Sequence[DepthScan],
    cell: Cell,
    *,
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]] = (),
    aside: int = 0,
    trials: int,
    seed: int,
    device: str = "auto",
    progress: ProgressMeter = UNWATCHED,
) -> Twin:
    """Fit the cell's scanner, and the look of its bin, to real scans.

    Args:
        pictures: a colour picture for each scan, or no pictures; see `restage`.
        aside: The search does not use this many scans at the end; they are classified separately.

    Raises:
        GraycastError: there are too few scans, the scans are from another camera than the rig's or
            not from structured light, pictures do not fit, or scikit-learn is not installed.
    """
    require_sklearn()
    check_scans(real, cell, aside=aside)
    fitted = len(real) - aside
    codes, parameters = candidate_codes(cell.scanner.named_code()), fitted_parameters(cell)
    progress.stage("staging the scenes of the scans")
    staged = restage(real, cell.scene, pictures)

    def light(some: slice, codes: Sequence[CodeSpec]) -> tuple[LitScene, ...]:
        with open_cell_renderer(cell, device=device) as renderer:
            return light_scenes(
                cell,
                staged[some],
                codes,
                seed=seed + some.start,
                renderer=renderer,
                rougher=COATS if BIN_GLOSS in {p.key for p in parameters} else (),
                names=[scan.name for scan in real[some]],
                progress=progress,
            )

    own, rest = slice(0, fitted), slice(fitted, len(real))
    lit = light(own, codes)
    progress.stage("measuring the real scans")
    floor = find_floor([scan.depth_m for scan in real[own]])
    figures = figures_of(real[own], floor, missing_places(lit, real[own]))
    fit = search(
        cell.scanner,
        lit,
        codes,
        parameters,
        figures,
        trials=trials,
        seed=seed,
        progress=progress,
    )
    other = seed + 100_000  # The classified scans need noise that the search did not use.
    before = list(scans_of(lit, cell.scanner, {}, seed=other, name="as configured"))
    if aside:
        lit += light(rest, (fit.scanner.named_code(),))
    after = list(scans_of(lit, fit.scanner, fit.values, seed=other, name="twin"))
    sets = {"before": (own, before), "after": (own, after)}
    if aside:
        sets["kept aside"] = (rest, after)
    classified = {}
    for name, (some, simulated) in sets.items():
        progress.stage(f"classifying the scans, {name}")
        classified[name] = two_sample_test(
            real[some],
            simulated[some],
            names=("real", "as configured" if name == "before" else "twin"),
            seed=seed,
        )
    examples = real[0], before[0], after[0]
    return Twin(fit=fit, scans=fitted, examples=examples, classified=classified)


def check_scans(real: Sequence[DepthScan], cell: Cell, *, aside: int = 0) -> None:
    """Check that a twin can be made from these scans, the last `aside` of which are not fitted.

    Raises:
        GraycastError: a twin cannot be made; the text has the reason and the remedy.
    """
    if len(real) - aside < LEAST_SCANS:
        raise GraycastError(
            f"{len(real)} scans are given, {aside} of them to keep aside: give at least "
            f"{LEAST_SCANS} to fit, so that their spread is known"
        )
    if 0 < aside < LEAST_ASIDE:
        raise GraycastError(
            f"{aside} scan is kept aside: keep at least {LEAST_ASIDE}, because the classifier "
            "leaves out each scan once, or none"
        )
    camera = cell.scanner.rig.camera
    for scan in real:
        height, width = scan.depth_m.shape
        if (height, width) != (camera.height_px, camera.width_px):
            raise GraycastError(
                f"{scan.name}: is {width} x {height} pixels, the rig's camera {camera.width_px} x "
                f"{camera.height_px}: give the rig the size and the intrinsics of the scans"
            )
        if abs(scan.K[0, 0] / camera.fx_px - 1) > 0.02:
            raise GraycastError(
                f"{scan.name}: has a focal length of {scan.K[0, 0]:.1f} px, the rig's camera "
                f"{camera.fx_px:.1f} px: give the rig the intrinsics of the scans"
            )
    refuse_without_shadow(real)


def refuse_without_shadow(scans: Sequence[DepthScan]) -> None:
    """Refuse scans without a shadow side, because one camera with one projector always causes one.

    If a near surface hides a far surface from the projector, the far surface has no depth. So on
    the side away from the projector, valid neighbours never have a depth step. Stereo cameras, and
    cameras very close to their light, have equal numbers of depth steps on both sides.

    Raises:
        GraycastError: there is no shadow side, or the scans have too few depth steps to decide.
    """
    counts = [count_steps(scan) for scan in scans]
    right, left, below, above = (
        sum(getattr(c, f"{side}_farther") for c in counts) / len(counts)
        for side in ("right", "left", "below", "above")
    )
    pairs = (right, left), (below, above)
    shares = [min(pair) / max(pair) for pair in pairs if max(pair) >= _LEAST_JUMPS]
    if not shares:
        raise GraycastError(
            f"the scans have {max(right, left, below, above):.0f} depth steps per map, which are "
            f"too few to identify the kind of scanner (at least {_LEAST_JUMPS} are needed): give "
            "scans with parts that stand out"
        )
    if min(shares) > _MOST_SHARE:
        raise GraycastError(
            "the scans have no shadow side: of the depth steps between valid neighbours "
            f"{right:.0f} a map fall to the right, {left:.0f} to the left, {below:.0f} downwards "
            f"and {above:.0f} upwards. Such scans are typical of active stereo and time of "
            "flight. A twin needs structured light, where one direction has almost no such "
            "steps: give raw scans of a structured-light scanner, or use another simulator"
        )


def fitted_parameters(cell: Cell) -> tuple[Parameter, ...]:
    """Return all parameters, except those of the bin's look that do not apply to this bin.

    A texture does not have a single colour, and the gloss of a metal depends on its colour.
    """
    box = bin_of(cell.scene)
    plain = [m for m in (box.material, box.floor) if m is not None]
    fitted = {p.key: p for p in PARAMETERS}
    if box.own_texture or any(m.texture is not None for m in plain):
        del fitted[BIN_COLOR]
    least, most = min(m.smoothest for m in plain), max(m.roughness for m in plain)
    specular = max(m.specular for m in plain)
    fixed = any(m.metallic > 0 for m in plain) or not specular or BIN_COLOR not in fitted
    if fixed or least - ROUGHER < _SMOOTHEST or most + ROUGHER > 1:
        del fitted[BIN_GLOSS], fitted[BIN_ROUGHNESS]
    else:
        gloss = fitted[BIN_GLOSS]
        fitted[BIN_GLOSS] = replace(gloss, high=min(gloss.high, 1 / specular))
    return tuple(fitted.values())
