"""Indirect light from another surface: depth of the presets, compared with known positions.

Without a renderer, each pixel receives the light of its own position in the projector's picture and
a share of that of another position, as if a neighbour mirrored it.
"""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from scipy import ndimage

from benchmarks.decoders import with_single_limits
from graycast.base.frames import pixel_grid, transform_points
from graycast.camera.decode import POSITIONED, FilterSpec, Reason
from graycast.camera.scanner import preset, scan
from graycast.cell.resolve import patterns_of
from graycast.rendering import Radiance
from graycast.rig.optics import project, rays

SHAPE = (96, 128)
PATCH_PX = 16  # the other position and its share are constant in a patch
WRONG_M, WRONG_SIGMAS = 1e-3, 5.0


@pytest.fixture(scope="module", params=[slow("like-phoxi-s"), "like-phoxi-m", slow("like-phoxi-l")])
def scanner(request):
    """Return a window of the preset's picture."""
    whole = preset(request.param, "small")
    h, w = SHAPE
    size = {"width_px": w, "height_px": h, "cx_px": (w - 1) / 2, "cy_px": (h - 1) / 2}
    return replace(whole, rig=replace(whole.rig, camera=replace(whole.rig.camera, **size)))


def facing_plane(scanner):
    """Return the depth [m] of a plane in mid-range, and its positions (n, 2) on the projector."""
    rig = scanner.rig
    z_m = np.full(SHAPE, (rig.near_m + rig.far_m) / 2)
    point = rays(rig.camera, pixel_grid(*SHAPE)) * z_m[..., None]
    return z_m, project(rig.projector, transform_points(rig.T_proj_cam, point))


def light(scanner, place, other, share, *, spread_px=1.0):
    """Return each pixel's light: from `place` with a blur of one pixel, and a share from `other`,
    spread by a rough surface over `spread_px`.
    """
    stack = []
    for picture in patterns_of(scanner):
        along_x = bool((picture == picture[0]).all())
        line = (picture[0] if along_x else picture[:, 0]) / 255
        axis = 0 if along_x else 1
        direct, indirect = (
            np.interp(at[..., axis], np.arange(len(line)), ndimage.gaussian_filter1d(line, blur_px))
            for at, blur_px in ((place, 1.0), (other, spread_px))
        )
        assert along_x or (picture.T == picture[:, 0]).all()  # one line is enough
        stack.append((1 - share) * direct + share * indirect)
    zero, grey = np.zeros(SHAPE, np.float32), np.full((*SHAPE, 3), 0.5, np.float32)
    return Radiance(
        pattern=np.array(stack, dtype=np.float32),
        white=np.ones(SHAPE, np.float32),
        ambient=zero,
        white_rgb=np.ones((*SHAPE, 3), np.float32),
        ambient_rgb=np.zeros((*SHAPE, 3), np.float32),
        albedo=grey,
        place_px=np.moveaxis(place, -1, 0).reshape(2, *SHAPE).astype(np.float32),
    )


def wrong(depth, z_m):
    """Return pixels whose depth has an error of more than 1 mm and five sigmas."""
    off_m = np.abs(depth.depth_m - z_m)
    return (off_m > WRONG_M) & (off_m > WRONG_SIGMAS * depth.sigma_m)


def patches(low, high, rng):
    """Return uniform numbers between two limits, one per patch."""
    h, w = (side // PATCH_PX for side in SHAPE)
    return np.kron(rng.uniform(low, high, (h, w)), np.ones((PATCH_PX, PATCH_PX)))


@pytest.mark.slow
def test_a_plane_in_direct_light_is_decoded_in_all_pixels(scanner):
    z_m, place = facing_plane(scanner)
    depth = scan(scanner, light(scanner, place, place, 0.0), seed=1).depth
    assert np.isfinite(depth.depth_m).mean() > 0.99
    assert not wrong(depth, z_m).any()


def test_light_mirrored_from_another_position_is_removed_by_its_epipolar_line(scanner):
    """The pixel sees only a position 60 columns and 40 rows away, in full contrast."""
    _, place = facing_plane(scanner)
    mirrored = light(scanner, place, place + np.array([60.0, 40.0]), 1.0)
    result = scan(scanner, mirrored, seed=1)
    assert (result.codes.reason == Reason.DECODED).mean() > 0.9  # the code alone cannot detect it
    assert not np.isfinite(result.depth.depth_m).any()


@pytest.mark.slow
def test_presets_refuse_wrong_pixels_in_mixed_light_unlike_the_plain_decoder(scanner):
    """The other position is up to 200 columns and rows away, with any share of the light, blurred
    by 5 pixels. (A preset cannot detect a sharp mirror image below a fifth of the light: no value
    of the pixel shows it.)
    """
    rng = np.random.default_rng(2)
    z_m, place = facing_plane(scanner)
    away = np.stack([patches(-200, 200, rng), patches(-200, 200, rng)], axis=-1)
    share = patches(0, 1, rng)
    depth = scan(scanner, light(scanner, place, place + away, share, spread_px=5.0), seed=1).depth
    assert wrong(depth, z_m).sum() <= 0.01 * np.isfinite(depth.depth_m).sum()
    mostly_direct = np.isfinite(depth.depth_m) & (share < 0.02)
    assert mostly_direct.sum() > 0.3 * (share < 0.02).sum()
    plain = replace(
        scanner,
        code=replace(scanner.code, axes=("column",), fine_period_px=None),
        decode=replace(scanner.decode, max_p_wrong=1.0),
    )
    believed = scan(plain, light(plain, place, place + away, share, spread_px=5.0), seed=1).depth
    assert wrong(believed, z_m).sum() > 0.3 * np.isfinite(believed.depth_m).sum()


def with_limit(scanner, max_p_wrong):
    """Return the scanner with another limit of the probability and without filters."""
    decode = replace(scanner.decode, max_p_wrong=max_p_wrong)
    return replace(scanner, decode=decode, filters=FilterSpec())


def test_the_probability_alone_tells_direct_from_mixed_light(scanner):
    """The probability keeps more of the right depth than single limits do."""
    rng = np.random.default_rng(2)
    z_m, place = facing_plane(scanner)
    away = np.stack([patches(-200, 200, rng), patches(-200, 200, rng)], axis=-1)
    share = patches(0, 1, rng)
    mixed = light(scanner, place, place + away, share, spread_px=5.0)
    unguarded = scan(with_limit(scanner, 1.0), mixed, seed=1).depth
    estimated = scan(with_limit(scanner, 0.1), mixed, seed=1).depth
    limited = scan(with_single_limits(scanner), mixed, seed=1).depth
    assert unguarded.p_wrong is None
    assert wrong(unguarded, z_m).sum() > 0.2 * np.isfinite(unguarded.depth_m).sum()
    assert wrong(estimated, z_m).sum() <= 0.005 * np.isfinite(estimated.depth_m).sum()
    right, right_with_limits = (
        (np.isfinite(depth.depth_m) & ~wrong(depth, z_m)).sum() for depth in (estimated, limited)
    )
    assert right > 1.1 * right_with_limits
    reasons = estimated.reason[np.isnan(estimated.depth_m)]
    assert (reasons == Reason.INTERREFLECTION).any()


def test_the_probability_alone_keeps_direct_light_and_no_mirror_image(scanner):
    _, place = facing_plane(scanner)
    careful = with_limit(scanner, 0.02)
    direct = scan(careful, light(scanner, place, place, 0.0), seed=1).depth
    assert np.isfinite(direct.depth_m).mean() > 0.99
    assert np.array_equal(np.isfinite(direct.p_wrong), np.isfinite(direct.depth_m))
    assert np.nanmax(direct.p_wrong) <= 0.02
    mirrored = light(scanner, place, place + np.array([60.0, 40.0]), 1.0)
    image = scan(careful, mirrored, seed=1).depth
    assert np.isfinite(image.depth_m).mean() < 0.01
    assert (image.reason == Reason.OUTLIER).mean() > 0.5


def test_a_pixel_that_is_removed_for_its_code_has_no_position(scanner):
    """Stored maps of positions must agree with the stored reasons."""
    rng = np.random.default_rng(2)
    _, place = facing_plane(scanner)
    away = np.stack([patches(-200, 200, rng), patches(-200, 200, rng)], axis=-1)
    mixed = light(scanner, place, place + away, patches(0, 1, rng), spread_px=5.0)
    result = scan(with_limit(scanner, 0.05), mixed, seed=1)
    positioned = np.isin(result.depth.reason, POSITIONED)
    for name in ("column", "row", "sigma_column", "sigma_row"):
        assert np.array_equal(np.isfinite(getattr(result.codes, name)), positioned)
    assert np.array_equal(result.codes.reason == Reason.DECODED, positioned)
    assert (result.depth.reason[~positioned] == Reason.INTERREFLECTION).any()
