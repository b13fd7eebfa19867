"""Two pictures of a scene are registered to a small fraction of a pixel, or not at all."""

import numpy as np
import pytest

from graycast.camera.stack.registration import prepare, register

SIZE = (90, 130)


def scene(x_px, y_px, *, seed=1, size=SIZE):
    """Return a sum of waves in closed form, shifted to the right and down."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    picture = np.full(size, 100.0)
    for _ in range(60):
        kx, ky, phase = rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(0, 6.3)
        picture += 4 * np.cos(kx * (x - x_px) + ky * (y - y_px) + phase)
    return picture


def motion_of(first, second, valid=None):
    valid = np.ones(first.shape, dtype=bool) if valid is None else valid
    return register(prepare(first, valid), prepare(second, valid))


@pytest.mark.parametrize("moved", [(0.0, 0.0), (0.3, -0.15), (2.1, 0.6), (-10.4, 3.0)])
def test_a_shift_is_measured_despite_changed_light_noise_and_exposure(moved):
    """Oracle: the distance by which the closed form was shifted."""
    rng = np.random.default_rng(2)
    first, second = (p + rng.normal(size=SIZE) for p in (scene(0, 0), 0.7 * scene(*moved) + 20))
    motion = motion_of(first, second)
    assert motion.known
    assert np.hypot(motion.x_px - moved[0], motion.y_px - moved[1]) < 0.03
    assert motion.sigma_px < 0.03


def test_saturated_pixels_and_a_moving_object_do_not_change_the_shift():
    """Saturated pixels are not valid; the object is a bright block of a tenth of the picture."""
    first, second = scene(0, 0), scene(1.3, 0.4)
    valid = np.maximum(first, second) < 115
    second[:30, :40] = 250
    motion = motion_of(np.minimum(first, 115), np.minimum(second, 115), valid)
    assert np.hypot(motion.x_px - 1.3, motion.y_px - 0.4) < 0.1


def test_a_scene_of_vertical_edges_gives_no_vertical_shift():
    rng = np.random.default_rng(3)
    stripes = np.broadcast_to(scene(0, 0)[:1], SIZE)
    moved = np.roll(stripes, (2, 2), axis=(0, 1))
    motion = motion_of(stripes + rng.normal(size=SIZE), moved + rng.normal(size=SIZE))
    assert motion.known
    assert motion.x_px == pytest.approx(2.0, abs=0.1)
    assert abs(motion.y_px) < 0.02


@pytest.mark.parametrize("other", ["noise", "another scene"])
def test_two_unrelated_pictures_give_no_shift(other):
    rng = np.random.default_rng(4)
    if other == "noise":
        first, second = (100 + rng.normal(size=SIZE) for _ in range(2))
    else:
        first, second = scene(0, 0), scene(0, 0, seed=7)
    assert not motion_of(first, second).known


def test_registration_does_not_change_its_arguments():
    """OpenCV's phase correlation multiplies its arguments by a window, in place."""
    size = (96, 128)  # Pictures of other sizes are copied into this size.
    whole = np.ones(size, dtype=bool)
    first = prepare(scene(0, 0, size=size), whole)
    second = prepare(scene(0, 0, seed=7, size=size), whole)
    before = [first.finest.value.copy(), second.finest.value.copy()]
    once = register(first, second)
    assert np.array_equal(first.finest.value, before[0])
    assert np.array_equal(second.finest.value, before[1])
    assert register(first, second) == once
