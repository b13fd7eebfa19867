"""What tests of our BSDFs ask them: samples, values and densities of many directions at once."""

import numpy as np


def arriving(wi, n=1):
    """`n` hits seen from one direction, or one hit for each column of `wi`."""
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.t, si.wi = 1.0, mi.Vector3f(np.asarray(wi, dtype=np.float32))
    return si


def leaning(angle_deg, turn_deg=0.0):
    """A direction so far from the normal, turned so far from x."""
    angle, turn = np.radians(angle_deg), np.radians(turn_deg)
    sine = np.sin(angle)
    return np.array([sine * np.cos(turn), sine * np.sin(turn), np.cos(angle)])


def upper(n, seed):
    """Uniform directions of the hemisphere, density 1 / (2 pi); columns."""
    rng = np.random.default_rng(seed)
    z, turn = rng.random(n), 2 * np.pi * rng.random(n)
    return np.stack(direction(z, turn))


def drawn(bsdf, wi, n, seed=0):
    """Directions (3, n), densities and weights (3, n) of samples."""
    import mitsuba as mi

    rng = np.random.default_rng(seed)
    si = arriving(wi, n)
    sample, weight = bsdf.sample(
        mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(rng.random((2, n)).astype("f4")), True
    )
    return np.array(sample.wo, dtype=float), np.array(sample.pdf), np.array(weight, dtype=float)


def evaluated(bsdf, wi, wo):
    """Values (3, n) without the cosine, and densities."""
    import mitsuba as mi

    towards = mi.Vector3f(wo.astype(np.float32))
    value, density = bsdf.eval_pdf(mi.BSDFContext(), arriving(wi, wo.shape[1]), towards, True)
    return np.array(value, dtype=float) / np.maximum(wo[2], 1e-9), np.array(density)


def direction(z, turn):
    across = np.sqrt(1 - z * z)
    return across * np.cos(turn), across * np.sin(turn), z
