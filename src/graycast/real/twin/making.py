"""From real scans and a cell's configuration to the twin: refuse, stage, light, search, judge."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...cell.config import resolve_quality
from ...cell.resolve import Cell, open_cell_renderer
from ...rig.pattern import CodeSpec
from ...world.parts import Material
from ...world.scene import bin_of
from ..realism import DepthScan, TwoSample, two_sample_test
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
from .refusing import refuse_without_shadow
from .restaging import restage
from .rows import figures_of
from .searching import Fit, scans_of, search
from .stage import LitScene, light_scenes, missing_places

LEAST_SCANS = 3
LEAST_KEPT = 2  # The classifier learns from these scans, which the search does not see.
_BRIGHTEST = 0.9
_SMOOTHEST = 0.1  # A coat of less roughness shows the lamp in single pixels.
COATS = (-ROUGHER, 0.0, ROUGHER)  # The bin is rendered with each of these coats.


@dataclass(frozen=True, slots=True, kw_only=True)
class Twin:
    """What was found, with pictures and the classifier's word on it.

    `examples` has a real scan, and its scene by the configured scanner and by the twin.
    `classified` has 'before' and 'after' the search, and 'kept aside' of scans that were.
    """

    fit: Fit
    scans: int  # that were fitted
    examples: tuple[DepthScan, DepthScan, DepthScan]
    classified: dict[str, TwoSample]


def make_twin(
    real: Sequence[DepthScan],
    cell: Cell,
    *,
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]] = (),
    kept: int = 0,
    trials: int,
    seed: int,
    device: str = "auto",
    progress: ProgressMeter = UNWATCHED,
) -> Twin:
    """Fit the cell's scanner, and the look of its bin, to real scans.

    Args:
        pictures: in colour, one for each scan, or none; see `restage`.
        kept: so many of the last scans the search does not see; the classifier judges them apart.

    Raises:
        GraycastError: there are too few scans, of another camera than the rig's, or of no
            structured light; pictures do not fit; scikit-learn is not installed.
    """
    require_sklearn()
    check_scans(real, cell, kept=kept)
    fitted = len(real) - kept
    codes, parameters = candidate_codes(cell.scanner.code), fitted_parameters(cell)
    progress.stage("staging the scenes of the scans")
    staged = restage(real, cell.scene, pictures)

    def light(chosen: slice, codes: Sequence[CodeSpec]) -> tuple[LitScene, ...]:
        with open_cell_renderer(cell, device=device) as renderer:
            return light_scenes(
                cell,
                staged[chosen],
                codes,
                seed=seed + chosen.start,
                renderer=renderer,
                quality=resolve_quality(cell.config),
                rougher=COATS if BIN_GLOSS in {p.key for p in parameters} else (),
                names=[scan.name for scan in real[chosen]],
                progress=progress,
            )

    own, aside = slice(0, fitted), slice(fitted, len(real))
    lit = light(own, codes)
    progress.stage("measuring the real scans")
    places = missing_places(lit, real[own])
    figures = figures_of(real[own], find_floor([scan.depth_m for scan in real[own]]), places)
    fit = search(
        cell.scanner,
        lit,
        codes,
        parameters,
        figures,
        places=places,
        trials=trials,
        seed=seed,
        progress=progress,
    )
    other = seed + 100_000  # the noise of what is judged is not that of the search
    before = list(scans_of(lit, cell.scanner, {}, seed=other, name="as configured"))
    if kept:
        lit += light(aside, (fit.scanner.code,))
    after = list(scans_of(lit, fit.scanner, fit.values, seed=other, name="twin"))
    perfect = [one.truth for one in lit]
    sets = {"before": (own, before, ()), "after": (own, after, perfect[own])}
    if kept:
        sets["kept aside"] = (aside, after, perfect[aside])
    classified = {}
    for name, (chosen, made, truth) in sets.items():
        progress.stage(f"classifying the scans, {name}")
        classified[name] = two_sample_test(
            real[chosen],
            made[chosen],
            perfect=truth,
            names=("real", "as configured" if name == "before" else "twin"),
            seed=seed,
        )
    examples = real[0], before[0], after[0]
    return Twin(fit=fit, scans=fitted, examples=examples, classified=classified)


def check_scans(real: Sequence[DepthScan], cell: Cell, *, kept: int = 0) -> None:
    """Whether a twin can be made of these scans, so many of which are kept aside.

    Raises:
        GraycastError: it cannot; the text says why, and what to give.
    """
    if len(real) - kept < LEAST_SCANS:
        raise GraycastError(
            f"{len(real)} scans are given, {kept} of them to keep aside: give at least "
            f"{LEAST_SCANS} to fit, so that their spread is known"
        )
    if 0 < kept < LEAST_KEPT:
        raise GraycastError(
            f"{kept} scan is kept aside: keep at least {LEAST_KEPT}, because the classifier leaves "
            "out each scan once, or none"
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


def fitted_parameters(cell: Cell) -> tuple[Parameter, ...]:
    """All that are declared; the bin's colour, gloss and roughness only where they can be changed.

    A texture has no one colour, and the gloss of a metal is its colour.
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


def scaled_color(material: Material, factor: float) -> list[float]:
    """A material's colour, so many times as bright, up to what a surface can reflect."""
    return [scaled_reflectance(band, factor) for band in material.base_color]


def scaled_reflectance(reflectance: float, factor: float) -> float:
    """So many times the reflectance, up to what a surface can reflect."""
    return round(min(reflectance * factor, _BRIGHTEST), 4)
