"""Division of tiled light, which the renderer's own BSDF has made with known materials."""

import math

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.real.material.classes import _mixture, divide, smooth_pieces
from graycast.real.material.observing import Reflections
from graycast.real.material.surface_model import mean_light, surface

SCALE = 5000.0
SIDE = 12  # Pixels along a tile
TILES = 6  # Along the picture


def tiles(materials, *, seed=1):
    """Tiles at random tilts, whose materials alternate, under a projector at 20 degrees."""
    rng = np.random.default_rng(seed)
    pixel = np.argwhere(np.ones((SIDE * TILES,) * 2, dtype=bool))
    number = pixel[:, 0] // SIDE * TILES + pixel[:, 1] // SIDE
    count = len(pixel)
    lean, turn = 0.7 * np.sqrt(rng.random(TILES**2)), 2 * math.pi * rng.random(TILES**2)
    tilt = np.stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)], -1)
    normal = tilt[number]
    x, y = pixel[:, 1] * 1e-3, pixel[:, 0] * 1e-3
    # Each tile is a plane, at a random height that makes a step to each neighbour.
    height = 0.05 * rng.permutation(TILES**2)[number]
    z = 0.6 + height - (normal[:, 0] * x + normal[:, 1] * y) / normal[:, 2]
    pixels = Reflections(
        normal=normal,
        to_camera=np.tile([0.0, 0.0, -1.0], (count, 1)),
        to_projector=np.tile([math.sin(0.35), 0.0, -math.cos(0.35)], (count, 1)),
        light=np.ones(count),
        sigma=np.full(count, 1e-3),
        clipped=np.zeros(count, dtype=bool),
        normal_sigma_rad=np.full(count, 0.004),
        area_px=np.full(count, 20.0),
        pixel=pixel,
        point_m=np.stack([x, y, z], axis=-1),
    )
    truth = number % len(materials)
    lights = np.stack([mean_light(pixels, material) for material in materials])
    light = SCALE * lights[truth, np.arange(count)] * (1 + 0.05 * rng.normal(size=count))
    changed = {name: getattr(pixels, name) for name in pixels.__slots__} | {"light": light}
    return Reflections(**changed), number, truth


@pytest.mark.slow
@pytest.mark.parametrize("scale", [SCALE, None], ids=["scale", "no scale"])
def test_two_materials_are_told_apart_and_one_is_not_split(cpu_device, scale):
    """Oracle: the known material of each tile; metal is brighter and darker than the plastic."""
    steel, grey = surface("metal", 0.4, 0.4), surface("plastic", 0.3, 0.5)
    pixels, _, truth = tiles([steel, grey])
    division = divide(pixels, scale=scale, seed=0)
    assert division.count == 2
    agreement = (division.label == truth).mean()
    assert max(agreement, 1 - agreement) > 0.95
    for one in (steel, grey):
        assert divide(tiles([one])[0], scale=scale, seed=0).count == 1


def test_a_piece_ends_at_a_step_and_at_a_crease_only(cpu_device):
    """Oracle: tiles with a step between any two; then two slopes that meet at 14 degrees."""
    pixels, number, _ = tiles([surface("plastic", 0.3, 0.5)])
    piece = smooth_pieces(pixels)
    assert len(np.unique(piece)) == TILES**2
    assert len(np.unique(np.stack([piece, number]), axis=1).T) == TILES**2
    right = pixels.pixel[:, 1] >= SIDE * TILES // 2
    normal = np.where(right[:, None], [-0.124, 0, -0.992], [0.124, 0, -0.992])
    away = (pixels.pixel[:, 1] - SIDE * TILES // 2) * 1e-3
    point_m = np.stack([away, pixels.pixel[:, 0] * 1e-3, 0.6 - np.abs(away) / 8], axis=-1)
    changed = {name: getattr(pixels, name) for name in pixels.__slots__}
    roof = Reflections(**changed | {"normal": normal, "point_m": point_m})
    piece = smooth_pieces(roof)
    assert np.array_equal(piece == piece[-1], right)


def test_the_number_of_classes_is_that_of_the_pieces_likelihoods():
    """Pieces prefer their own candidate by a large or by a small difference."""
    windows = np.full(30, 10.0)
    own = np.arange(30) % 3 // 2  # Two thirds prefer candidate 0.
    for difference, count in ((50.0, 2), (0.2, 1)):
        score = -difference * (own != np.arange(3)[:, None])
        _, label = _mixture(score, windows)
        assert label.max() + 1 == count
        assert count == 1 or np.array_equal(label, own)


def test_a_division_needs_enough_smooth_pixels(cpu_device):
    pixels, *_ = tiles([surface("plastic", 0.3, 0.5)])
    with pytest.raises(GraycastError, match="only 0 pixels are on smooth surfaces"):
        divide(pixels.part(np.arange(5)), scale=SCALE, seed=0)
