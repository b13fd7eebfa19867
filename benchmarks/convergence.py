"""Convergence of decoded depth to a reference as the number of samples increases."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool

from graycast.camera.scanner import Scan, Scanner, scan
from graycast.camera.sensor import SensorSpec
from graycast.cell.resolve import Cell
from graycast.rendering import DenoiserName, Quality, Radiance, Renderer
from graycast.world.scene import Layout

from .cells import exposed_alike
from .decoded import decoding_error, edge_shifts, fine_contrast, one_surface, valid
from .figures import Figures, Show

REFERENCE_SEED = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """A scene, converged pictures of it by one renderer, and the scan decoded from the pictures."""

    cell: Cell
    layout: Layout
    radiance: Radiance
    scanner: Scanner
    result: Scan
    on_surface: Bool[np.ndarray, "h w"]


def converge(cell: Cell, layout: Layout, renderer: Renderer, samples: int, show: Show) -> Reference:
    """Render and decode the reference of a renderer, with many samples and no denoiser."""
    show(f"{renderer.name}: reference of {samples} samples")
    radiance, _ = _render(cell, layout, renderer, samples, "none", REFERENCE_SEED)
    scanner = exposed_alike(cell.scanner, radiance)
    result = scan(scanner, radiance, seed=0)
    return Reference(
        cell=cell,
        layout=layout,
        radiance=radiance,
        scanner=scanner,
        result=result,
        on_surface=one_surface(result),
    )


def error_row(
    reference: Reference,
    renderer: Renderer,
    samples: int,
    denoise: DenoiserName,
    show: Show,
    *,
    sensors: Sequence[SensorSpec] = (),
) -> tuple[Figures, list[Figures]]:
    """Render once; return the error without sensor noise, and with the noise of each sensor."""
    show(f"{renderer.name}: {samples} samples, denoise {denoise}")
    radiance, seconds = _render(
        reference.cell, reference.layout, renderer, samples, denoise, samples
    )
    words = {"renderer": renderer.name, "denoise": denoise, "samples": samples}
    result = scan(reference.scanner, radiance, seed=0)
    code = reference.cell.code
    row = words | {"seconds": seconds} | decoding_error(result, reference.result)
    row |= edge_shifts(radiance, reference.radiance, code, reference.on_surface)
    fine = (
        fine_contrast(light, code, valid(reference.result))
        for light in (radiance, reference.radiance)
    )
    row["fine_contrast"] = next(fine) / next(fine)
    noisy = []
    for sensor in sensors:
        scanner = exposed_alike(
            Scanner(rig=reference.scanner.rig, code=reference.scanner.code, sensor=sensor),
            reference.radiance,
        )
        taken = scan(scanner, radiance, seed=1)
        noisy.append(words | decoding_error(taken, reference.result))
    return row, noisy


def samples_for(rows: Sequence[Figures], measure: str, target: float) -> tuple[float, str]:
    """Interpolate by a power law the number of samples at which rows have the error `target`.

    Returns:
        The number of samples, and '<' or '>' if it is outside the tried range, else ''.
    """
    rows = sorted(rows, key=lambda row: row["samples"])
    if rows[0][measure] <= target:
        return float(rows[0]["samples"]), "<" if rows[0][measure] < target else ""
    for one, other in pairwise(rows):
        if other[measure] <= target:
            if other[measure] <= 0 or target <= 0:
                return float(other["samples"]), ""
            share = math.log(one[measure] / target) / math.log(one[measure] / other[measure])
            return one["samples"] * (other["samples"] / one["samples"]) ** share, ""
    return float(rows[-1]["samples"]), ">"


def _render(
    cell: Cell,
    layout: Layout,
    renderer: Renderer,
    samples: int,
    denoise: DenoiserName,
    seed: int,
) -> tuple[Radiance, float]:
    patterns = cell.patterns()
    quality = Quality(samples=samples, denoise=denoise)
    start = time.perf_counter()
    rendering = renderer.render(cell.scene, layout, patterns, quality=quality, seed=seed)
    return rendering.radiance, time.perf_counter() - start
