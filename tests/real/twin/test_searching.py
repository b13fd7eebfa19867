"""The search for a twin: reproducibility, convergence, and the models of falloff and colour."""

from dataclasses import replace

import numpy as np
import pytest
from small_cell import shrunk
from stage import in_camera, lambert, wall

from graycast.base.progress import UNWATCHED
from graycast.camera.scanner import Scanner
from graycast.camera.sensor import SensorSpec
from graycast.real.realism import DepthScan
from graycast.real.realism.patches import find_floor
from graycast.real.twin import searching
from graycast.real.twin.parameters import PARAMETERS, shares_of, with_values
from graycast.real.twin.rows import Figures, Row, compare, figures_of, loss_of
from graycast.real.twin.searching import scans_of, search
from graycast.real.twin.stage import BinLook, LitScene, in_projector_corner, scan_lit
from graycast.rendering import Quality
from graycast.rendering.reference import ReferenceRenderer
from graycast.rig.pair import preset_rig
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT, Sphere

FALLOFF = next(p for p in PARAMETERS if p.key == "projector.falloff")
DIRECT = Quality(samples=4, depth=1)
FITTED = [p for p in PARAMETERS if p.key in ("sensor.read_noise_e", "filters.smoothing_px")]


@pytest.fixture(scope="module")
def stage():
    """Return a scanner of 160 x 120 px, and two lit scenes of a sphere in front of a wall."""
    rig = preset_rig("paper")
    camera, projector = shrunk(rig.camera, 160, 120), shrunk(rig.projector, 256, 192)
    rig = replace(rig, name="small", camera=camera, projector=projector)
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=16.0, steps=4)
    scanner = Scanner(rig=rig, code=code, sensor=SensorSpec())
    lit = []
    for x_m in (-0.05, 0.04):
        scene = in_camera(rig, ball(x_m), wall(0.8, lambert(0.05), half_m=1.0))
        rendering = ReferenceRenderer().render(
            scene,
            EMPTY_LAYOUT,
            scanner.light_code().render(),
            quality=DIRECT,
            seed=0,
        )
        lit.append(
            LitScene(
                radiance={code: rendering.radiance},
                is_bin=rendering.truth.depth_m > 0.79,  # the wall
                truth=DepthScan(
                    name="t", depth_m=rendering.truth.depth_m.astype(float), K=camera.K
                ),
            )
        )
    return scanner, tuple(lit)


def ball(x_m):
    return Sphere(center_m=(x_m, 0.0, 0.72), radius_m=0.06, material=lambert(0.5))


def hidden(stage, **values):
    scanner, lit = stage
    hidden_scanner = with_values(scanner, FITTED, values)
    return list(scans_of(lit, hidden_scanner, {}, seed=77, name="real"))


def result_of(stage, real, trials=40):
    scanner, lit = stage
    figures = figures_of(real, find_floor([one.depth_m for one in real]))
    return search(scanner, lit, [scanner.code], FITTED, figures, trials=trials, seed=1)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_search(stage):
    real = hidden(stage, **{"sensor.read_noise_e": 30.0, "filters.smoothing_px": 0.5})
    first, second = (result_of(stage, real, trials=40) for _ in range(2))
    assert first == second
    assert 18 < first.trials <= 42  # A Jacobian may exceed the number of trials by 2.


@pytest.mark.slow
def test_the_search_finds_two_unknown_parameters(stage):
    """The first steps end in another local minimum, with a misfit of 0.57 and a read noise of 3."""
    real = hidden(stage, **{"sensor.read_noise_e": 30.0, "filters.smoothing_px": 0.5})
    result = result_of(stage, real, trials=300)
    assert result.values["sensor.read_noise_e"] == pytest.approx(30.0, rel=0.2)
    assert result.values["filters.smoothing_px"] == pytest.approx(0.5, abs=0.05)
    assert result.loss < 0.3
    for one, value in zip(result.estimates, (30.0, 0.5), strict=True):
        assert one.low <= value <= one.high
        assert one.parameter.share(one.high) - one.parameter.share(one.low) < 0.2


def test_the_model_for_falloff_agrees_with_the_renderer(stage, monkeypatch):
    """Oracle: a rendered picture with the falloff, for direct light."""
    scanner, (lit, _) = stage
    rig = scanner.rig
    lit = replace(lit, corner_share=in_projector_corner(rig, lit.truth.depth_m))
    dimmed = with_values(scanner, [FALLOFF], {FALLOFF.key: 0.6})
    taken = []
    monkeypatch.setattr(
        "graycast.real.twin.stage.shoot",
        lambda scanner, radiance, seed: taken.append(radiance) or (_ for _ in ()).throw(ValueError),
    )
    list(scans_of([lit], dimmed, {}, seed=1, name="s"))
    scene = in_camera(dimmed.rig, ball(-0.05), wall(0.8, lambert(0.05), half_m=1.0))
    rendering = ReferenceRenderer().render(
        scene, EMPTY_LAYOUT, scanner.light_code().render(), quality=DIRECT, seed=0
    )
    own, twin = rendering.radiance.white, taken[0].white
    bright = own > 0
    assert (twin[bright] / lit.radiance[scanner.code].white[bright]).min() < 0.75
    # At an edge, the light of a pixel comes from several points, but its depth from one.
    assert np.quantile(np.abs(twin[bright] / own[bright] - 1), 0.97) < 2e-3


@pytest.mark.slow
def test_only_the_simulated_scanner_that_made_the_scans_matches_them(stage):
    """The noise has another seed and the same strength; chance alone gives a misfit of about 1."""

    def figures(seed, read_noise_e=20.0, smoothing_px=0.0):
        values = {"sensor.read_noise_e": read_noise_e, "filters.smoothing_px": smoothing_px}
        scanner = with_values(stage[0], FITTED, values)
        return figures_of(list(scans_of(stage[1], scanner, {}, seed=seed, name="real")), None)

    real = figures(77)
    rows = compare(real, figures(78))
    assert loss_of(rows) < 1 and all(row.is_met for row in rows)
    for other in ({"read_noise_e": 60.0}, {"smoothing_px": 1.0}):
        rows = compare(real, figures(78, **other))
        assert loss_of(rows) > 5 and not all(row.is_met for row in rows)


def test_a_brighter_bin_has_the_same_effect_as_a_longer_exposure(stage):
    """Four times the light of the bin gives the same depth as four times the exposure, except next
    to the sphere, whose light and depth do not change."""
    scanner, (lit, _) = stage

    def depth(color, exposure_s):
        taken = replace(scanner, exposure=replace(scanner.exposure, exposure_s=exposure_s))
        return scan_lit(lit, taken, BinLook(color=color), seed=3, name="s").depth_m

    plain, bright, longer = depth(1.0, 2e-3), depth(4.0, 2e-3), depth(1.0, 8e-3)
    ball = ~lit.is_bin
    assert np.isfinite(plain[ball]).mean() > 0.8 and np.isfinite(plain[~ball]).mean() < 0.1
    np.testing.assert_array_equal(bright[ball], plain[ball])
    same = (bright == longer) | (np.isnan(bright) & np.isnan(longer))
    assert same[~ball].mean() > 0.98 and np.isfinite(bright[~ball]).mean() > 0.8


def formula(stage, monkeypatch, off):
    """Return a search whose rows are the formula `off` of code and shares, and its trials."""
    places = []

    class Formula(searching._Trials):
        def rows(self, code, x):
            places.append((code, x.tobytes()))
            return tuple(
                Row(name=f"{k}", unit="", real=0.0, spread=1.0, twin=float(value))
                for k, value in enumerate(off(code, x))
            )

    monkeypatch.setattr(searching, "_Trials", Formula)

    def run(codes, trials):
        count = len(off(codes[0], np.full(2, 0.5)))
        real = Figures(value={f"{k}": np.zeros(3) for k in range(count)})
        start = replace(stage[0], code=codes[0])
        return search(start, stage[1], codes, FITTED, real, trials=trials, seed=1)

    return run, places


def test_the_search_converges_from_a_start_that_is_sixty_spreads_off(stage, monkeypatch):
    """A constant limit of large deviations would have no slope there."""
    monkeypatch.setattr(searching, "_STARTS", 0)

    def off(code, x):
        return [100 * (x[0] - 0.8), 30 * (x[1] - 0.6)]

    run, _ = formula(stage, monkeypatch, off)
    result = run([stage[0].code], 60)
    assert off(None, shares_of(stage[0], FITTED))[0] < -40
    assert result.loss < 0.01
    assert shares_of(result.scanner, FITTED) == pytest.approx([0.8, 0.6], abs=0.01)


def test_the_search_finds_a_code_that_fits_well_far_from_the_configured_scanner(stage, monkeypatch):
    """At the start points, this code is nowhere better than the configured code."""
    coarse = stage[0].code
    fine = replace(coarse, period_px=12.0)
    start = shares_of(stage[0], FITTED)
    laser = np.array([p.share(p.laser) for p in FITTED])
    valley = np.array([0.2, 0.8])

    def off(code, x):
        far = np.linalg.norm(x - valley)
        return [2.0, 0.0] if code == coarse else [4.0, 0.0] if far > 0.4 else 8 * (x - valley)

    run, _ = formula(stage, monkeypatch, off)
    result = run([coarse, fine], 160)
    assert min(np.linalg.norm(start - valley), np.linalg.norm(laser - valley)) > 0.5
    assert result.scanner.code == fine
    assert result.loss < 0.01
    assert result.by_code[coarse.period_px] > 1


def test_estimated_slopes_agree_with_the_slopes_of_the_rows(stage):
    """The rows are linear. Near an upper bound, the finite difference is taken downwards."""

    class Linear(searching._Trials):
        def rows(self, code, x):
            off = 0.2 * x[0] - 0.1 * x[1]
            return (Row(name="a", unit="", real=0.0, spread=1.0, twin=float(off)),)

    real = Figures(value={"a": np.zeros(3)})
    run = Linear(stage[0], stage[1], FITTED, real, 1, 10, UNWATCHED)
    assert run.slopes(stage[0].code, np.array([0.5, 0.95])) == pytest.approx(
        np.array([[0.2, -0.1]]), rel=0.01
    )


def test_a_repeated_trial_is_not_simulated_again(stage, monkeypatch):
    """The steps of the best code continue where they ended before."""
    run, places = formula(
        stage, monkeypatch, lambda code, x: [3 + np.sin(9 * x[0]) * np.cos(7 * x[1]), x[0]]
    )
    codes = [replace(stage[0].code, period_px=period_px) for period_px in (16.0, 12.0)]
    result = run(codes, 150)
    assert result.trials == len(places) == len(set(places))
    assert result.trials <= 150 + len(FITTED)


@pytest.mark.slow
def test_the_search_recovers_from_parameters_without_any_light(stage, monkeypatch):
    """The first step is too long, because large errors are compressed, and has no rows."""
    monkeypatch.setattr(searching, "_STARTS", 0)
    run, places = formula(
        stage, monkeypatch, lambda code, x: [40 * (x[1] - 0.8)] if x[1] < 0.85 else []
    )
    result = run([stage[0].code], 60)
    assert any(np.frombuffer(place)[1] >= 0.85 for _, place in places)
    assert result.loss < 0.5  # Finite differences of 0.1 also reach the dark range.
