"""Samples, values and densities of BSDFs for many directions at once."""

import numpy as np


def arriving(wi, n=1):
    """Return `n` surface hits with one incident direction, or a hit for each column of `wi`."""
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.t, si.wi = 1.0, mi.Vector3f(np.asarray(wi, dtype=np.float32))
    return si


def leaning(angle_deg, turn_deg=0.0):
    """Return a unit vector from its angle to the normal and its azimuth from x."""
    angle, turn = np.radians(angle_deg), np.radians(turn_deg)
    sine = np.sin(angle)
    return np.array([sine * np.cos(turn), sine * np.sin(turn), np.cos(angle)])


def upper(n, seed):
    """Return uniform random directions on the upper hemisphere as columns; density 1 / (2 pi)."""
    rng = np.random.default_rng(seed)
    z, turn = rng.random(n), 2 * np.pi * rng.random(n)
    return np.stack(direction(z, turn))


def samples_of(bsdf, wi, n, seed=0):
    """Return the directions (3, n), densities and weights (3, n) of samples."""
    import mitsuba as mi

    rng = np.random.default_rng(seed)
    si = arriving(wi, n)
    place = mi.Point2f(rng.random((2, n)).astype("f4"))
    lobe = mi.Float(rng.random(n).astype("f4"))
    sample, weight = bsdf.sample(mi.BSDFContext(), si, lobe, place, True)
    return np.array(sample.wo, dtype=float), np.array(sample.pdf), np.array(weight, dtype=float)


def evaluated(bsdf, wi, wo):
    """Return the values (3, n) without the cosine, and the densities."""
    import mitsuba as mi

    towards = mi.Vector3f(wo.astype(np.float32))
    value, density = bsdf.eval_pdf(mi.BSDFContext(), arriving(wi, wo.shape[1]), towards, True)
    return np.array(value, dtype=float) / np.maximum(wo[2], 1e-9), np.array(density)


def direction(z, turn):
    across = np.sqrt(1 - z * z)
    return across * np.cos(turn), across * np.sin(turn), z


def assert_samples_fall_where_densities_say(bsdf, wi, *, fine, n=200_000):
    """The density and the share of samples below the surface add up to 1. In each of 8 x 8 cells,
    the number of samples agrees with the density (chi-squared). The grid has `fine`^2 directions.
    """
    z, turn = (np.arange(fine) + 0.5) / fine, 2 * np.pi * (np.arange(fine) + 0.5) / fine
    grid = np.stack(np.broadcast_arrays(*direction(z[:, None], turn[None]))).reshape(3, -1)
    density = evaluated(bsdf, wi, grid)[1].reshape(8, fine // 8, 8, fine // 8)
    cells = density.sum(axis=(1, 3)) * 2 * np.pi / fine**2
    wo, _, weight = samples_of(bsdf, wi, n)
    above = weight[0] > 0
    assert abs(cells.sum() + (~above).mean() - 1) < 0.004
    place = np.arctan2(wo[1], wo[0])[above] % (2 * np.pi)
    counts = np.histogram2d(wo[2, above], place, bins=8, range=[[0, 1], [0, 2 * np.pi]])[0]
    enough = cells * n > 50
    expected = cells[enough] * n
    chi2 = ((counts[enough] - expected) ** 2 / (expected + (0.004 * expected) ** 2)).sum()
    assert chi2 < enough.sum() + 7 * np.sqrt(2 * enough.sum())
