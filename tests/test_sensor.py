"""The sensor against the laws that its noise must obey: photon transfer, Poisson, independence."""

import math

import numba
import numpy as np
import pytest
from scipy import stats

from graycast.sensor import SensorSpec, auto_exposure_s, expose

# Electrons are the unit: one per unit of radiance and second.
PLAIN = SensorSpec(
    full_well_e=1e6,
    read_noise_e=4.0,
    gain_dn_per_e=2.0,
    offset_dn=100.0,
    bit_depth=16,
    responsivity=1.0,
)
SIDE = 200
COUNT = SIDE * SIDE


def sensor(**changes):
    words = {name: getattr(PLAIN, name) for name in PLAIN.__dataclass_fields__}
    return SensorSpec(**{**words, **changes})


def frames_of(mean_e, spec=PLAIN, *, frames=1, seed=11, background=None):
    radiance = np.full((frames, SIDE, SIDE), mean_e, dtype=np.float32)
    return expose(radiance, background, spec, exposure_s=1.0, seed=seed).frames


def obeys_photon_transfer(dn, mean_e, spec):
    """Mean K mu + offset and variance K^2 (mu + read^2) + 1/12, to four standard errors.

    The variance of a variance of n numbers with fourth central moment m4 is (m4 - s^4) / n.
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
def test_mean_and_variance_obey_photon_transfer(mean_e, read_noise_e):
    """EMVA 1288, over both ways in which numbers are drawn: below and above 64 electrons."""
    spec = sensor(read_noise_e=read_noise_e)
    assert obeys_photon_transfer(frames_of(mean_e, spec), mean_e, spec)


@pytest.mark.parametrize("mean_e", [40.0, 5000.0])
def test_the_photon_transfer_check_notices_wrong_noise_and_wrong_gain(mean_e):
    """Noise absent; 3 % too strong; 3 % too weak; a level 1 % off; read noise forgotten.

    Of 160,000 pixels the standard deviation is known to 0.2 %.
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
def test_low_counts_are_exactly_poisson(mean_e):
    """Without read noise, at one DN per electron: chi-square of the counts."""
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
    seen = np.bincount(np.clip(counts, low, high) - low, minlength=len(edges))
    assert stats.chisquare(seen, expected * counts.size).pvalue > 1e-3
    normal = np.rint(np.random.default_rng(0).normal(mean_e, math.sqrt(mean_e), counts.size))
    wrong = np.bincount(np.clip(normal, low, high).astype(int) - low, minlength=len(edges))
    assert stats.chisquare(wrong, expected * counts.size).pvalue < 1e-6  # the test can fail


def test_photons_and_read_noise_are_independent_of_each_other():
    """Chi-square against the convolution of Poisson and normal, binned by the converter."""
    mean_e, read_noise_e = 3.0, 1.5
    spec = sensor(read_noise_e=read_noise_e, gain_dn_per_e=4.0)
    dn = frames_of(mean_e, spec, frames=4).ravel().astype(int)
    edges = np.arange(70, 161)
    count = np.arange(40)
    upper = ((edges[:, None] + 0.5 - 100) / 4 - count) / read_noise_e  # dn is rounded
    below = (stats.norm.cdf(upper) * stats.poisson.pmf(count, mean_e)).sum(axis=1)
    expected = np.diff(below, prepend=0.0)
    expected[-1] += 1 - below[-1]
    seen = np.bincount(np.clip(dn, 70, 160) - 70, minlength=len(edges))
    enough = expected * dn.size > 20
    rest = 1 - expected[enough].sum()
    assert rest * dn.size > 5
    seen = np.append(seen[enough], dn.size - seen[enough].sum())
    assert stats.chisquare(seen, np.append(expected[enough], rest) * dn.size).pvalue > 1e-3


def test_many_electrons_are_normal_and_their_tails_are_there():
    dn = frames_of(10_000.0, frames=4).astype(float).ravel()
    score = (dn - 20_100.0) / math.sqrt(4 * (10_000 + 16) + 1 / 12)
    assert stats.kstest(score, "norm").pvalue > 1e-3
    assert 3.9 < np.abs(score).max() < 6.0  # of 160,000 draws


def correlation(a, b):
    """In standard errors: r sqrt(n) is standard normal for independent pairs."""
    return np.corrcoef(a.ravel(), b.ravel())[0, 1] * math.sqrt(a.size)


@pytest.mark.parametrize("mean_e", [5.0, 1000.0])
def test_frames_neighbours_and_seeds_are_independent(mean_e):
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


def test_one_seed_is_one_picture_and_seed_zero_is_like_any():
    for seed in (0, 1):
        assert np.array_equal(frames_of(50.0, seed=seed), frames_of(50.0, seed=seed))
    assert (frames_of(50.0, seed=0) != frames_of(50.0, seed=1)).mean() > 0.9


def test_the_picture_does_not_depend_on_the_number_of_threads():
    before = numba.get_num_threads()
    try:
        pictures = []
        for threads in sorted({1, before}):
            numba.set_num_threads(threads)
            pictures.append(frames_of(80.0, frames=3))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(pictures[0], other) for other in pictures)


def test_a_bigger_stack_has_the_frames_of_a_smaller_one():
    """Frame k draws from its own numbers, whatever comes after it."""
    assert np.array_equal(frames_of(80.0, frames=5)[:3], frames_of(80.0, frames=3))


def test_radiance_exposure_and_background_make_electrons():
    """mu = (L + background) responsivity time: the same electrons in three ways."""
    spec = sensor(responsivity=50.0)
    radiance = np.full((1, SIDE, SIDE), 3.0, dtype=np.float32)
    background = np.full((SIDE, SIDE), 5.0, dtype=np.float32)
    dn = expose(radiance, background, spec, exposure_s=2.0, seed=1).frames
    assert obeys_photon_transfer(dn, 8.0 * 50 * 2, spec)
    dn = expose(radiance, None, spec, exposure_s=2.0, seed=1).frames
    assert obeys_photon_transfer(dn, 3.0 * 50 * 2, spec)


def test_a_full_well_and_a_full_converter_both_saturate():
    well = sensor(full_well_e=1000.0)
    assert (frames_of(2000.0, well) == 2100).all() and well.saturation_dn == 2100
    for bits, dtype in [(12, np.uint16), (8, np.uint8), (1, np.uint8), (16, np.uint16)]:
        offset_dn = min(100.0, 2.0**bits - 2)
        converter = sensor(bit_depth=bits, offset_dn=offset_dn)
        dn = frames_of(1e5, converter)
        assert dn.dtype == dtype and (dn == 2**bits - 1).all()
        assert converter.saturation_dn == converter.max_dn == 2**bits - 1


def test_darkness_is_the_offset_with_read_noise_cut_at_zero():
    dn = frames_of(0.0, sensor(offset_dn=0.0, read_noise_e=4.0)).astype(float)
    assert dn.min() == 0
    # Half of the normal law is cut to 0: mean sigma / sqrt(2 pi).
    assert abs(dn.mean() / (8.0 / math.sqrt(2 * math.pi)) - 1) < 0.02
    assert (frames_of(0.0, sensor(read_noise_e=0.0)) == 100).all()


@pytest.mark.parametrize("percentile", [50.0, 99.0])
@pytest.mark.parametrize("target", [0.3, 0.8])
def test_auto_exposure_puts_the_percentile_on_its_target(percentile, target):
    """Measured in the noise-free limit: a stack of one constant level equal to the percentile."""
    spec = SensorSpec()
    brightest = np.random.default_rng(0).gamma(2.0, 3.0, (60, 80))
    exposure_s = auto_exposure_s(brightest, spec, percentile=percentile, target=target)
    level = np.sort(brightest.ravel())[round(percentile / 100 * (brightest.size - 1))]
    stack = np.full((1, 100, 100), level, dtype=np.float32)
    dn = expose(stack, None, spec, exposure_s=exposure_s, seed=0).frames
    share = (dn.mean() - spec.offset_dn) / (spec.saturation_dn - spec.offset_dn)
    assert abs(share - target) < 0.01


def test_auto_exposure_refuses_the_dark():
    with pytest.raises(ValueError, match="dark"):
        auto_exposure_s(np.zeros((4, 4)), PLAIN, percentile=99.0, target=0.8)


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, math.inf, math.nan])
def test_impossible_exposures_are_refused(exposure_s):
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
        ("responsivity", 0.0),
        ("read_noise_e", -0.1),
        ("read_noise_e", math.nan),
        ("offset_dn", -1.0),
        ("offset_dn", 65535.0),
    ],
)
def test_impossible_sensors_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        sensor(**{name: value})


def test_pictures_cannot_be_changed_afterwards():
    dn = frames_of(1.0)
    with pytest.raises(ValueError, match="read-only"):
        dn[0, 0, 0] = 1
