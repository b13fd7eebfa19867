"""Twins of random, hidden scanners, for docs/measurements/twin.md.

python -m studies.unknown_scanners --draws 10 --trials 500

A twin of each scanner is fitted to three simulated scans, and compared with it. As in `graycast
real twin`, the rig and the scenes are known to the fit, but here the surfaces have no error. The
hidden numbers are drawn from the middle four fifths of the fitted ranges, and the code is one of
the candidates.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from graycast.camera.scanner import Scanner, preset
from graycast.real.realism import DepthScan
from graycast.real.realism.patches import find_floor
from graycast.real.twin.parameters import (
    BIN_GLOSS,
    BIN_ROUGHNESS,
    PARAMETERS,
    candidate_codes,
    values_at,
    with_values,
)
from graycast.real.twin.rows import compare, figures_of, loss_of
from graycast.real.twin.searching import Fit, scans_of, search
from graycast.real.twin.stage import LitScene, in_projector_corner
from graycast.rendering import Quality
from graycast.rendering.reference import ReferenceRenderer
from graycast.rig.pair import grey_levels
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Quad, Scene, Sphere

from .smaller import shrunk

SCENES = 3
FITTED = tuple(p for p in PARAMETERS if p.key not in (BIN_GLOSS, BIN_ROUGHNESS))  # all is matt
_FLOOR_M, _FLOOR_ALBEDO = 0.47, 0.04
_MARGIN = 0.1  # share of a parameter's range, at each end, without hidden numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """A hidden scanner, and the fit of its twin."""

    period_px: float | None
    hidden: dict[str, float]
    own: float  # the misfit of the hidden scanner itself, with new noise
    fit: Fit

    @property
    def inside(self) -> dict[str, bool]:
        """Whether the hidden number is in the interval, for each parameter."""
        return {
            one.parameter.key: one.low <= self.hidden[one.parameter.key] <= one.high
            for one in self.fit.estimates
        }


def study(number: int, lit: Sequence[LitScene], *, trials: int) -> Unknown:
    """Draw a hidden scanner, scan the scenes with it, and fit a twin with the same scenes."""
    start = small_scanner()
    codes = tuple(lit[0].radiance)
    rng = np.random.default_rng((15, number))
    shares = rng.uniform(_MARGIN, 1 - _MARGIN, len(FITTED))
    hidden = values_at(shares, FITTED)
    code = codes[int(rng.integers(len(codes)))]
    scanner = replace(with_values(start, FITTED, hidden), code=code)
    real, again = (
        list(scans_of(lit, scanner, hidden, seed=1_000 * k + number, name="real")) for k in (1, 2)
    )
    floor = find_floor([scan.depth_m for scan in real])
    figures = figures_of(real, floor)
    own = loss_of(compare(figures, figures_of(again, floor)))
    fit = search(start, lit, codes, FITTED, figures, trials=trials, seed=number)
    return Unknown(period_px=code.period_px, hidden=hidden, own=own, fit=fit)


def small_scanner() -> Scanner:
    """Return a PhoXi-S with a quarter of the smallest preset's pixels and sharp lenses."""
    scanner = preset("like-phoxi-s", "small")
    sharp: dict[str, Any] = {"aperture_m": 0.0, "psf_px": 0.0, "natural_vignetting": False}
    camera, projector = (replace(o, **sharp) for o in (scanner.rig.camera, scanner.rig.projector))
    half = shrunk(camera, camera.width_px // 2, camera.height_px // 2)
    return replace(scanner, rig=replace(scanner.rig, camera=half, projector=projector))


def light(scanner: Scanner, rng: np.random.Generator) -> LitScene:
    """Render a dark floor, eight balls on and above it and two leaning boards, with each code."""

    def grey(low: float, high: float) -> Material:
        return Material(base_color=(float(rng.uniform(low, high)),) * 3, specular=0.0)

    def place(low_m: float, high_m: float) -> tuple[float, float, float]:
        x, y = rng.uniform(-0.09, 0.09), rng.uniform(-0.07, 0.07)
        return float(x), float(y), float(rng.uniform(low_m, high_m))

    dark = Material(base_color=(_FLOOR_ALBEDO,) * 3, specular=0.0)
    things: list[Quad | Sphere] = [board((0.0, 0.0, _FLOOR_M), 0.5, 0.1, 0.05, dark)]
    for _ in range(8):
        radius_m = float(rng.uniform(0.012, 0.03))
        things.append(
            Sphere(center_m=place(0.42, 0.46), radius_m=radius_m, material=grey(0.1, 0.7))
        )
    for _ in range(2):
        lean_x, lean_y = rng.uniform(-0.8, 0.8, 2).tolist()
        things.append(board(place(0.43, 0.45), 0.03, lean_x, lean_y, grey(0.1, 0.7)))
    rig, codes = scanner.rig, candidate_codes(scanner.named_code())
    scene = Scene(
        rig=rig,
        T_world_cam=np.eye(4),
        surfaces=tuple(things),
        environment=Environment(radiance=(0.0, 0.0, 0.0)),
    )
    light_codes = [replace(scanner, code=code).light_code() for code in codes]
    stack = [one.render(lambda share: grey_levels(rig, share)) for one in light_codes]
    rendering = ReferenceRenderer().render(
        scene, EMPTY_LAYOUT, np.concatenate(stack), quality=Quality(samples=9, depth=1), seed=0
    )
    ends = np.cumsum([len(one) for one in stack])
    whole, depth_m = rendering.radiance, rendering.truth.depth_m.astype(np.float64)
    return LitScene(
        radiance={
            code: replace(whole, pattern=whole.pattern[end - len(one) : end].copy())
            for code, one, end in zip(codes, stack, ends, strict=True)
        },
        is_bin=np.abs(whole.albedo[..., 0] - _FLOOR_ALBEDO) < 1e-3,
        truth=DepthScan(name="perfect", depth_m=depth_m, K=rig.camera.K),
        corner_share=in_projector_corner(rig, depth_m),
    )


def board(
    center_m: tuple[float, float, float],
    half_m: float,
    lean_x: float,
    lean_y: float,
    material: Material,
) -> Quad:
    """Return a square in front of the camera that faces it, tilted by two slopes."""
    u = np.array([1.0, 0.0, lean_x]) / np.hypot(1.0, lean_x)
    normal = np.array([lean_x, lean_y, -1.0])
    v = np.cross(normal / np.linalg.norm(normal), u)
    return Quad(
        center_m=center_m,
        half_u_m=tuple((half_m * u).tolist()),
        half_v_m=tuple((half_m * v).tolist()),
        material=material,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Make twins of scanners that are drawn by seeds.")
    parser.add_argument("--draws", type=int, default=10, help="The number of scanners.")
    parser.add_argument("--trials", type=int, default=500, help="Simulations of each search.")
    parser.add_argument("--first", type=int, default=0, help="The seed of the first scanner.")
    options = parser.parse_args()
    scanner = small_scanner()
    lit = [light(scanner, np.random.default_rng((16, k))) for k in range(SCENES)]
    print(
        "| draw | statistics met, before | after | misfit | of the scanner itself | code | within |"
    )
    print("|---" * 7 + "|")
    for number in range(options.first, options.first + options.draws):
        one = study(number, lit, trials=options.trials)
        met = [sum(row.is_met for row in rows) for rows in (one.fit.before, one.fit.after)]
        right = min(one.fit.by_code, key=lambda c: one.fit.by_code[c]) == one.period_px
        cells = [
            f"{number}",
            f"{met[0]}",
            f"{met[1]} of {len(one.fit.after)}",
            f"{one.fit.loss:.2f}",
            f"{one.own:.2f}",
            "right" if right else "another",
            f"{sum(one.inside.values())} of {len(one.inside)}",
        ]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
