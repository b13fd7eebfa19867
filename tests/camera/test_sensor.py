"""The sensor and the laws of its noise: photon transfer, Poisson, independence."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy import stats

from graycast.camera.sensor import (
    Capture,
    SensorSpec,
    auto_exposure_s,
    expose,
    merge_exposures,
    stored_saturation_dn,
)

PLAIN = SensorSpec(
    full_well_e=1e6,
    read_noise_e=4.0,
    gain_dn_per_e=2.0,
    offset_dn=100.0,
    bit_depth=16,
    dark_current_e_s=0.0,
)
SIDE = 200
COUNT = SIDE * SIDE


def sensor(**changes):
    return replace(PLAIN, **changes)


def frames_of(mean_e, spec=PLAIN, *, frames=1, seed=11, background=None):
    """Return flat frames with that mean number of photo-electrons, taken in one second."""
    radiance = np.full((frames, SIDE, SIDE), mean_e / spec.responsivity, dtype=np.float32)
    return expose(radiance, background, spec, exposure_s=1.0, seed=seed).frames


def obeys_photon_transfer(dn, mean_e, spec):
    """Return whether mean and variance obey K mu + offset and K^2 (mu + read^2) + 1/12.

    The tolerance is four standard errors. The variance of a variance of n numbers with fourth
    central moment m4 is (m4 - s^4) / n.
    """
    dn = dn.astype(float).ravel()
    gain = spec.gain_dn_per_e
    variance = gain**2 * (mean_e + spec.read_noise_e**2) + 1 / 12
    error_of_mean = math.sqrt(variance / dn.size)
    centred = dn - dn.mean()
    error_of_variance = math.sqrt(((centred**4).mean() - dn.var() ** 2) / dn.size)
    mean_fits = abs(dn.mean() - gain * mean_e - spec.offset_dn) < 4 * error_of_mean
    return bool(mean_fits and abs(dn.var() - variance) < 4 * max(error_of_variance, 1e-9))


@pytest.mark.parametrize("mean_e", [0.0, 3.0, 40.0, 63.9, 64.1, 200.0, 5000.0, 30000.0])
@pytest.mark.parametrize("read_noise_e", [1.0, 4.0])
def test_mean_and_variance_of_a_picture_obey_the_photon_transfer_law(mean_e, read_noise_e):
    """The law of EMVA 1288 holds for both ways of drawing numbers: below and above 64 electrons."""
    spec = sensor(read_noise_e=read_noise_e)
    assert obeys_photon_transfer(frames_of(mean_e, spec), mean_e, spec)


@pytest.mark.parametrize("mean_e", [40.0, 5000.0])
def test_the_photon_transfer_check_notices_wrong_noise_and_wrong_gain(mean_e):
    """Cases: no noise, 3 % too strong or too weak, a level 1 % off, no read noise.

    With 160,000 pixels, the standard deviation is known to 0.2 %.
    """
    dn = frames_of(mean_e, frames=4).astype(float)
    assert obeys_photon_transfer(dn, mean_e, PLAIN)
    middle = 2.0 * mean_e + 100
    assert not obeys_photon_transfer(np.full(dn.shape, middle), mean_e, PLAIN)
    assert not obeys_photon_transfer(middle + 1.03 * (dn - middle), mean_e, PLAIN)
    assert not obeys_photon_transfer(middle + 0.97 * (dn - middle), mean_e, PLAIN)
    assert not obeys_photon_transfer(dn * 1.01, mean_e, PLAIN)
    assert not obeys_photon_transfer(dn, mean_e, sensor(read_noise_e=0.0)) or mean_e > 1000


@pytest.mark.parametrize("mean_e", [0.5, 3.0, 20.0])
def test_low_electron_counts_follow_the_poisson_law_exactly(mean_e):
    """Without read noise and at one DN per electron, the oracle is chi-square of the counts."""
    spec = sensor(read_noise_e=0.0, gain_dn_per_e=1.0, offset_dn=10.0)
    counts = frames_of(mean_e, spec, frames=4).ravel().astype(int) - 10
    assert counts.min() >= 0
    low, high = (int(stats.poisson.ppf(q, mean_e)) for q in (1e-4, 1 - 1e-4))
    edges = np.arange(low, high + 1)
    expected = stats.poisson.pmf(edges, mean_e)
    expected[0], expected[-1] = (
        stats.poisson.cdf(low, mean_e),
        stats.poisson.sf(high - 1, mean_e),
    )
    observed = np.bincount(np.clip(counts, low, high) - low, minlength=len(edges))
    assert stats.chisquare(observed, expected * counts.size).pvalue > 1e-3
    normal = np.rint(np.random.default_rng(0).normal(mean_e, math.sqrt(mean_e), counts.size))
    wrong = np.bincount(np.clip(normal, low, high).astype(int) - low, minlength=len(edges))
    assert stats.chisquare(wrong, expected * counts.size).pvalue < 1e-6  # the test can fail


def test_photon_noise_and_read_noise_are_independent():
    """Oracle: chi-square of the convolution of Poisson and normal, binned by the converter."""
    mean_e, read_noise_e = 3.0, 1.5
    spec = sensor(read_noise_e=read_noise_e, gain_dn_per_e=4.0)
    dn = frames_of(mean_e, spec, frames=4).ravel().astype(int)
    edges = np.arange(70, 161)
    count = np.arange(40)
    upper = ((edges[:, None] + 0.5 - 100) / 4 - count) / read_noise_e  # dn is rounded
    below = (stats.norm.cdf(upper) * stats.poisson.pmf(count, mean_e)).sum(axis=1)
    expected = np.diff(below, prepend=0.0)
    expected[-1] += 1 - below[-1]
    observed = np.bincount(np.clip(dn, 70, 160) - 70, minlength=len(edges))
    enough = expected * dn.size > 20
    rest = 1 - expected[enough].sum()
    assert rest * dn.size > 5
    observed = np.append(observed[enough], dn.size - observed[enough].sum())
    assert stats.chisquare(observed, np.append(expected[enough], rest) * dn.size).pvalue > 1e-3


def test_high_electron_counts_follow_a_normal_law_even_in_the_tails():
    dn = frames_of(10_000.0, frames=4).astype(float).ravel()
    score = (dn - 20_100.0) / math.sqrt(4 * (10_000 + 16) + 1 / 12)
    assert stats.kstest(score, "norm").pvalue > 1e-3
    assert 3.9 < np.abs(score).max() < 6.0  # of 160,000 draws


def correlation(a, b):
    """Return the correlation in standard errors: r sqrt(n) is normal for independent pairs."""
    return np.corrcoef(a.ravel(), b.ravel())[0, 1] * math.sqrt(a.size)


@pytest.mark.parametrize("mean_e", [5.0, 1000.0])
def test_noise_is_independent_between_frames_neighbours_and_seeds(mean_e):
    dn = frames_of(mean_e, frames=8).astype(float)
    for k in range(1, 8):
        assert abs(correlation(dn[0], dn[k])) < 4
    assert abs(correlation(dn[:, :, 1:], dn[:, :, :-1])) < 4
    assert abs(correlation(dn[:, 1:], dn[:, :-1])) < 4
    assert abs(correlation(dn[1:], dn[:-1])) < 4
    for seed in (0, 12, 2**33):
        other = frames_of(mean_e, frames=8, seed=seed).astype(float)
        assert abs(correlation(dn, other)) < 4
    squares = (dn - dn.mean()) ** 2
    assert abs(correlation(squares[0], squares[1])) < 4


def test_one_seed_gives_one_picture_and_zero_is_an_ordinary_seed():
    for seed in (0, 1):
        assert np.array_equal(frames_of(50.0, seed=seed), frames_of(50.0, seed=seed))
    assert (frames_of(50.0, seed=0) != frames_of(50.0, seed=1)).mean() > 0.9


def test_the_number_of_threads_does_not_change_the_picture():
    before = numba.get_num_threads()
    try:
        pictures = []
        for threads in sorted({1, numba.config.NUMBA_NUM_THREADS}):
            numba.set_num_threads(threads)
            pictures.append(frames_of(80.0, frames=3))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(pictures[0], other) for other in pictures)


def test_adding_frames_to_a_stack_does_not_change_earlier_frames():
    """Frame k has its own random numbers, whatever comes after it."""
    assert np.array_equal(frames_of(80.0, frames=5)[:3], frames_of(80.0, frames=3))


def test_the_default_responsivity_follows_from_lens_pixel_and_light():
    """Oracle: energy of a photon from 1239.84 eV nm; the lens as a disc seen from the pixel."""
    spec = SensorSpec(lens_transmission=0.9)
    focal_m = 0.016
    disc_sr = math.pi * (focal_m / 8.0 / 2) ** 2 / focal_m**2
    photon_j = 1239.841984 / 525 * 1.602176634e-19
    electrons = 0.6 * 0.9 * disc_sr * 3.45e-6**2 / photon_j
    assert abs(spec.responsivity / electrons - 1) < 1e-7
    assert abs(SensorSpec().responsivity / 2.4e5 - 1) < 0.05  # the value of the first pictures


def test_electrons_follow_from_radiance_exposure_and_background():
    """mu = (L + background) responsivity time gives the same electrons in three ways."""
    radiance = np.full((1, SIDE, SIDE), 3.0, dtype=np.float32)
    background = np.full((SIDE, SIDE), 5.0, dtype=np.float32)
    exposure_s = 100 / PLAIN.responsivity
    dn = expose(radiance, background, PLAIN, exposure_s=exposure_s, seed=1).frames
    assert obeys_photon_transfer(dn, 8.0 * 100, PLAIN)
    dn = expose(radiance, None, PLAIN, exposure_s=exposure_s, seed=1).frames
    assert obeys_photon_transfer(dn, 3.0 * 100, PLAIN)


@pytest.mark.parametrize("mean_e", [0.0, 500.0])
def test_dark_current_adds_electrons_in_proportion_to_exposure_time(mean_e):
    spec = sensor(dark_current_e_s=40.0)
    radiance = np.full((1, SIDE, SIDE), mean_e / spec.responsivity / 2.5, dtype=np.float32)
    dn = expose(radiance, None, spec, exposure_s=2.5, seed=1).frames
    assert obeys_photon_transfer(dn, mean_e + 100, spec)


@pytest.mark.parametrize("mean_e", [0.0, 20.0, 3000.0])
def test_the_stated_variance_agrees_with_the_scatter_of_stored_values(mean_e):
    """Dark current is included: for the decoder, it is a part of the signal."""
    spec = sensor(dark_current_e_s=30.0, read_noise_e=2.0)
    dn = frames_of(mean_e, spec, frames=4).astype(float)
    stated = spec.variance_dn2(float(dn.mean()))
    assert abs(dn.var() / stated - 1) < 4 * math.sqrt(2 / dn.size) + 0.005 * (mean_e == 0)
    below = spec.variance_dn2(np.array([0.0, 100.0], dtype=np.float32))
    assert below[0] == below[1] == np.float32(4 * 4 + 1 / 12)


def test_a_full_well_clips_electrons_before_read_noise_is_added():
    """Photons beyond the well are lost before the read-out adds its noise."""
    well = sensor(full_well_e=1000.0)
    dn = frames_of(2000.0, well, frames=4).astype(float)
    error = math.sqrt((8.0**2 + 1 / 12) / dn.size)
    assert abs(dn.mean() - 2100) < 4 * error
    assert abs(dn.var() / (8.0**2 + 1 / 12) - 1) < 4 * math.sqrt(2 / dn.size)
    assert abs(stats.skew(dn.ravel())) < 4 * math.sqrt(6 / dn.size)
    assert 2e-6 < (dn < stored_saturation_dn(well)).mean() < 2e-4  # 4 sigma: 3e-5
    assert (frames_of(2000.0, sensor(full_well_e=1000.0, read_noise_e=0.0)) == 2100).all()


def test_saturation_begins_four_deviations_of_dark_noise_below_the_full_well():
    """Oracle: the normal law; of 160,000 pixels, the share above four deviations is too small."""
    spec = sensor(full_well_e=3000.0, gain_dn_per_e=20.0, dsnu_e=4.0)
    dn = frames_of(6000.0, spec, frames=4)
    deviation_dn = 20.0 * math.sqrt(4.0**2 + 4.0**2)
    for above in (1.0, 2.0):
        share = (dn < spec.saturation_dn + above * deviation_dn).mean()
        expected = stats.norm.cdf(above - 4.0)
        assert abs(share - expected) < 4 * math.sqrt(expected / COUNT)


@pytest.mark.parametrize("mean_e", [900.0, 1000.0, 1030.0])
def test_counts_near_the_full_well_follow_a_clipped_normal_law(mean_e):
    """Oracle: mean and variance of a censored normal, from its quantiles."""
    well = sensor(full_well_e=1000.0)
    sigma_e = math.sqrt(mean_e)
    counted = np.minimum(stats.norm(mean_e, sigma_e).ppf((np.arange(1e6) + 0.5) / 1e6), 1000.0)
    dn = frames_of(mean_e, well, frames=4).astype(float)
    variance = 4 * (counted.var() + 16) + 1 / 12
    assert abs(dn.mean() - 100 - 2 * counted.mean()) < 4 * math.sqrt(variance / dn.size)
    error = math.sqrt(((dn - dn.mean()) ** 4).mean() - dn.var() ** 2) / math.sqrt(dn.size)
    assert abs(dn.var() - variance) < 4 * error


@pytest.mark.parametrize(
    ("bits", "dtype"), [(12, np.uint16), (8, np.uint8), (1, np.uint8), (16, np.uint16)]
)
def test_a_saturated_converter_gives_its_largest_number(bits, dtype):
    converter = sensor(bit_depth=bits, offset_dn=min(100.0, 2.0**bits - 2))
    dn = frames_of(1e5, converter)
    assert dn.dtype == dtype and (dn == 2**bits - 1).all()
    assert converter.saturation_dn == converter.max_dn == 2**bits - 1


def test_a_dark_picture_is_the_offset_plus_read_noise_clipped_at_zero():
    dn = frames_of(0.0, sensor(offset_dn=0.0, read_noise_e=4.0)).astype(float)
    assert dn.min() == 0
    # Half of the normal law is clipped to 0: the mean is sigma / sqrt(2 pi).
    assert abs(dn.mean() / (8.0 / math.sqrt(2 * math.pi)) - 1) < 0.02
    assert (frames_of(0.0, sensor(read_noise_e=0.0)) == 100).all()


def pattern_of(mean_e, spec, *, seed):
    """Return the mean of 64 frames minus the ideal one [DN]; temporal noise is divided by 8."""
    stored = frames_of(mean_e, spec, frames=64, seed=seed).mean(axis=0, dtype=np.float64)
    return stored - spec.gain_dn_per_e * mean_e - spec.offset_dn


@pytest.mark.slow
def test_offsets_and_gains_have_the_configured_fixed_pattern():
    """DSNU is constant; PRNU is proportional to the signal."""
    spec = sensor(dsnu_e=3.0, prnu=0.01, read_noise_e=1.0)
    dark, bright = pattern_of(0.0, spec, seed=1), pattern_of(20_000.0, spec, seed=2)
    tolerance = 4 * math.sqrt(0.5 / COUNT)
    assert abs(math.sqrt(dark.var() - (4 + 1 / 12) / 64) / 6.0 - 1) < tolerance
    gains = bright - dark
    temporal = (4 * 20_000 + 2 * (4 + 1 / 12)) / 64
    assert abs(math.sqrt(gains.var() - temporal) / 400.0 - 1) < 2 * tolerance
    assert abs(correlation(dark, gains)) < 4
    for pattern in (dark, gains):
        assert abs(correlation(pattern[1:], pattern[:-1])) < 4
        assert stats.kstest(pattern.ravel() / pattern.std(), "norm").pvalue > 1e-3


@pytest.mark.slow
def test_the_fixed_pattern_is_equal_in_all_captures_with_one_sensor():
    spec = sensor(dsnu_e=10.0)
    first, second = (pattern_of(0.0, spec, seed=seed) for seed in (1, 2))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.99
    other = pattern_of(0.0, replace(spec, fpn_seed=1), seed=1)
    assert abs(correlation(first, other)) < 4


@pytest.mark.parametrize(("mean_e", "fixed"), [(5000.0, {"prnu": 0.02}), (0.0, {"dsnu_e": 30.0})])
def test_noise_and_fixed_pattern_are_independent_even_with_one_seed(mean_e, fixed):
    """The pattern is measured in many frames of another capture; frame 0 minus it is the noise."""
    spec = sensor(read_noise_e=10.0, fpn_seed=5, **fixed)
    pattern = pattern_of(mean_e, spec, seed=6)
    ideal = spec.gain_dn_per_e * mean_e + spec.offset_dn
    for seed in (5, 7):
        noise = frames_of(mean_e, spec, frames=1, seed=seed)[0] - ideal - pattern
        # The measured pattern has the rest of the noise, an eighth of a frame's, which is in both.
        rest = (noise.var() / 65) / (noise.std() * pattern.std()) * math.sqrt(noise.size)
        assert abs(correlation(noise, pattern) + rest) < 4, seed


CONTRAST = np.geomspace(1.0, 2000.0, 64).astype(np.float32)


def scene_capture(exposure_s, *, frames=4, seed=3, spec=PLAIN):
    """Return a ramp of 2000 : 1 that a shutter of 1 s maps to 10 to 20,000 photo-electrons."""
    radiance = np.tile(CONTRAST * 10 / spec.responsivity, (frames, 3000, 1))
    radiance *= np.linspace(1.0, 0.5, frames, dtype=np.float32)[:, None, None]
    return expose(radiance, None, spec, exposure_s=exposure_s, seed=seed)


def test_three_exposures_cover_a_scene_of_2000_to_1():
    """Each level has the signal-to-noise ratio of the longest exposure that does not saturate."""
    spec = sensor(full_well_e=6000.0)
    captures = [scene_capture(t, seed=i, spec=spec) for i, t in enumerate((0.2, 30.0, 2.0))]
    merged = merge_exposures(captures)
    assert merged.frames.max() < stored_saturation_dn(spec)
    assert (captures[2].frames.max(axis=(0, 1)) > stored_saturation_dn(spec)).any()
    allowed_e = spec.full_well_e - 16
    for k, level in enumerate(CONTRAST):
        means_e = {t: t * float(level) * 10 for t in (0.2, 2.0, 30.0)}
        if any(abs(mu - allowed_e) < 6 * math.sqrt(mu) for mu in means_e.values()):
            continue  # Noise alone decides here.
        best_s = max(t for t, mu in means_e.items() if mu < allowed_e)
        mean_e = means_e[best_s]
        assert (merged.exposure_s[:, k] == np.float32(best_s)).all()
        signal = merged.frames[0, :, k] - 100.0
        ratio = mean_e / math.sqrt(mean_e + 16 + 1 / 48)
        assert abs(signal.mean() / signal.std() / ratio - 1) < 6 * math.sqrt(0.5 / len(signal))


def test_all_frames_of_a_merged_pixel_are_from_one_exposure():
    """For one of three values, only the second frame saturates in the longest exposure."""
    full = stored_saturation_dn(PLAIN)
    values = {1.0: (10, 20), 2.0: (20, 40), 4.0: (40, full)}
    captures = [
        Capture(frames=np.array(v, np.uint16).reshape(2, 1, 1), sensor=PLAIN, exposure_s=t)
        for t, v in values.items()
    ]
    merged = merge_exposures(captures)
    assert merged.frames.ravel().tolist() == [20, 40] and merged.exposure_s.tolist() == [[2.0]]
    assert merge_exposures(captures[2:]) is captures[2]
    brightest = np.full((2, 1, 1), full, dtype=np.uint16)
    always = [Capture(frames=brightest, sensor=PLAIN, exposure_s=t) for t in (3.0, 0.5)]
    merged = merge_exposures(always)
    assert merged.exposure_s.tolist() == [[0.5]] and (merged.frames == full).all()


@pytest.mark.slow
def test_captures_of_different_scenes_are_not_merged():
    one, two = scene_capture(1.0), scene_capture(2.0)
    with pytest.raises(ValueError, match="at least one"):
        merge_exposures([])
    with pytest.raises(ValueError, match="one sensor and one code"):
        merge_exposures([one, scene_capture(2.0, frames=3)])
    with pytest.raises(ValueError, match="one sensor and one code"):
        merge_exposures([one, scene_capture(2.0, spec=sensor(read_noise_e=1.0))])
    with pytest.raises(ValueError, match="already merged"):
        merge_exposures([one, merge_exposures([one, two])])


@pytest.mark.parametrize("percentile", [50.0, 99.0])
@pytest.mark.parametrize("target", [0.3, 0.8])
@pytest.mark.parametrize("dark_share", [0.0, 0.5])
def test_automatic_exposure_brings_the_percentile_to_its_target(percentile, target, dark_share):
    """Without noise, the stack has one constant level, which equals the percentile.

    A dark current of half the light's electrons reduces the exposure by a third.
    """
    spec = SensorSpec()
    brightest = np.random.default_rng(0).gamma(2.0, 3.0, (60, 80))
    level = np.sort(brightest.ravel())[round(percentile / 100 * (brightest.size - 1))]
    spec = replace(spec, dark_current_e_s=float(dark_share * spec.responsivity * level))
    exposure_s = auto_exposure_s(brightest, spec, percentile=percentile, target=target)
    stack = np.full((1, 100, 100), level, dtype=np.float32)
    dn = expose(stack, None, spec, exposure_s=exposure_s, seed=0).frames
    share = (dn.mean() - spec.offset_dn) / (spec.saturation_dn - spec.offset_dn)
    assert abs(share - target) < 0.01


def test_automatic_exposure_refuses_a_dark_picture():
    with pytest.raises(ValueError, match="dark"):
        auto_exposure_s(np.zeros((4, 4)), PLAIN, percentile=99.0, target=0.8)


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, math.inf, math.nan])
def test_impossible_exposure_settings_are_refused(exposure_s):
    with pytest.raises(ValueError, match="exposure_s"):
        expose(np.ones((1, 2, 2)), None, PLAIN, exposure_s=exposure_s, seed=0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("bit_depth", 0),
        ("bit_depth", 17),
        ("full_well_e", 0.0),
        ("gain_dn_per_e", -1.0),
        ("gain_dn_per_e", math.nan),
        ("f_number", 0.0),
        ("pixel_pitch_m", -1e-6),
        ("wavelength_m", math.inf),
        ("quantum_efficiency", 1.1),
        ("lens_transmission", 0.0),
        ("dark_current_e_s", -1.0),
        ("dsnu_e", math.nan),
        ("prnu", 0.5),
        ("fpn_seed", -1),
        ("full_well_e", 16.0),
        ("read_noise_e", -0.1),
        ("read_noise_e", math.nan),
        ("offset_dn", -1.0),
        ("offset_dn", 65535.0),
    ],
)
def test_the_error_for_an_impossible_sensor_setting_names_its_key(name, value):
    with pytest.raises(ValueError, match=name):
        sensor(**{name: value})


def test_captured_pictures_are_read_only():
    dn = frames_of(1.0)
    with pytest.raises(ValueError, match="read-only"):
        dn[0, 0, 0] = 1
