"""The evidence of a pixel against closed forms of ideal and of mixed light."""

import numpy as np
import pytest
from scipy import ndimage
from stage import centred, make_rig

from graycast.camera.decode import CodeMap, Levels, Mark, Reason, triangulate
from graycast.camera.decode.evidence import NAMES, cues_of
from graycast.rig.pattern import CODECS, CodeSpec, level_share

SIZE = (24, 40)  # rows and columns of the camera's picture
PROJECTOR = (256, 160)
DARK_DN, LIT_DN = 200.0, 2000.0
LEVELS = Levels(offset_dn=100.0, saturation_dn=4095.0, floor_dn2=4.0, slope_dn=0.5)


def plane():
    """Return projector positions of a slanted plane, with steps of 1.3 columns and 1.1 rows."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    return 60.3 + 1.3 * x + 0.2 * y, 50.2 + 1.1 * y


def shares(code, column, row):
    """Return the share of white in each frame at projector positions, linear between pixels."""
    images = []
    for frame in code.frames:
        if frame.axis is None:
            images.append(np.full(column.shape, float(frame.kind == "white")))
            continue
        i = 0 if frame.axis == "column" else 1
        line = level_share(
            frame,
            PROJECTOR[i],
            offset_px=code.offset_px[i],
            stride_px=code.stride_px[i],
        )
        place = (column, row)[i]
        if frame.kind == "phase":
            images.append(np.interp(place, np.arange(len(line)), line))
        else:
            images.append(line[np.floor(place + 0.5).astype(int)])
    return np.stack(images)


def pictures(share):
    return np.round(DARK_DN + LIT_DN * share).astype(np.uint16)


def code_map(column, row, sigma_px=0.05, reason=None):
    decoded = np.zeros(column.shape, np.uint8) if reason is None else reason
    sigma = np.full(column.shape, sigma_px, dtype=np.float32)
    return CodeMap(
        column=column.astype(np.float32),
        row=row.astype(np.float32),
        sigma_column=sigma.copy(),
        sigma_row=sigma,
        modulation=np.full(column.shape, 0.5, dtype=np.float32),
        reason=decoded,
        mark=np.zeros(column.shape, np.uint8) & Mark.CLIPPED,
    )


def named(frames, code, codes):
    """Return the cues without a rig, by name."""
    return dict(zip(NAMES, cues_of(frames, code, LEVELS, codes, None, None), strict=True))


def code_of(codec, axes=("column", "row")):
    return CodeSpec(codec=codec, axes=axes).code(*PROJECTOR)


@pytest.mark.parametrize("codec", CODECS)
def test_direct_light_has_full_contrast_and_no_misfit(codec):
    code = code_of(codec)
    cues = named(pictures(shares(code, *plane())), code, code_map(*plane()))
    for axis in ("across", "along"):
        known = np.isfinite(cues[f"largest misfit {axis}"])
        assert known.all()
        assert cues[f"largest misfit {axis}"].max() < 0.01
        for part in ("coarse", "fine"):
            contrast = cues[f"{part} contrast {axis}"]
            if np.isfinite(contrast).any():
                np.testing.assert_allclose(contrast[np.isfinite(contrast)], 1, atol=0.02)


def test_the_contrast_of_two_equal_returns_is_the_closed_form():
    """Oracle: cosines that are d apart sum to one with |cos(pi d / P)| of the amplitude."""
    code = CodeSpec(codec="gray_phase", period_px=48.0, fine_period_px=16.0, steps=4).code(
        *PROJECTOR
    )
    column, row = plane()
    apart_px = 5.0
    both = 0.5 * (shares(code, column, row) + shares(code, column + apart_px, row))
    cues = named(pictures(both), code, code_map(column + apart_px / 2, row))
    fine = cues["fine contrast across"]
    np.testing.assert_allclose(fine, np.cos(np.pi * apart_px / 16), atol=0.02)
    assert (cues["fine over coarse contrast across"] < 0.8).all()


def test_frames_at_a_wrong_position_do_not_fit():
    code = code_of("gray")
    column, row = plane()
    cues = named(pictures(shares(code, column, row)), code, code_map(column + 37, row))
    assert (cues["largest misfit across"] > 0.4).mean() > 0.9


def test_a_plane_is_in_line_everywhere_but_at_its_border():
    column, row = plane()
    code = code_of("gray")
    cues = named(pictures(shares(code, column, row)), code, code_map(column, row))
    inner = np.s_[2:-2, 2:-2]
    assert (cues["pairs in line"][inner] == 12).all()
    assert (cues["neighbours"][inner] == 24).all()
    assert (cues["directions not in line"] == 0).all()
    assert (cues["directions in line"][inner] == 8).all()
    np.testing.assert_allclose(cues["largest step"][inner], 1.3, atol=1e-3)
    assert (cues["size of surface"] == np.float32(np.log2(SIZE[0] * SIZE[1]))).all()


def test_a_position_off_the_surface_is_off_by_its_distance():
    column, row = plane()
    column[12, 20] += 16
    code = code_of("gray")
    cues = named(pictures(shares(code, *plane())), code, code_map(column, row, sigma_px=0.5))
    assert cues["off the surface"][12, 20] == pytest.approx(4, abs=1e-3)  # log2 of 16 px
    assert cues["off the surface over sigma"][12, 20] == pytest.approx(5, abs=1e-3)
    assert cues["pairs in line"][12, 20] == 0
    assert cues["size of surface"][12, 20] == 0


def test_surface_sizes_equal_the_labels_of_scipy():
    column, row = plane()
    rng = np.random.default_rng(3)
    reason = np.where(rng.random(SIZE) < 0.4, Reason.SHADOW, Reason.DECODED).astype(np.uint8)
    code = code_of("gray")
    codes = code_map(column, row, reason=reason)
    cues = named(pictures(shares(code, *plane())), code, codes)
    label, count = ndimage.label(reason == Reason.DECODED)
    size = ndimage.sum_labels(np.ones(SIZE), label, np.arange(count + 1))[label]
    known = reason == Reason.DECODED
    np.testing.assert_allclose(2 ** cues["size of surface"][known], size[known], rtol=1e-5)
    assert np.isnan(cues["size of surface"][~known]).all()


def test_the_epipolar_cues_are_the_distance_of_decoded_rows():
    rig = make_rig(centred(SIZE[1], SIZE[0], 60.0), centred(*PROJECTOR, 200.0))
    code = code_of("gray_phase")
    flat = CodeMap(
        **{
            name: np.full(SIZE, value, np.float32)
            for name, value in {
                "column": 150.0,
                "row": 80.0,
                "sigma_column": 0.05,
                "sigma_row": 0.05,
                "modulation": 0.5,
            }.items()
        },
        reason=np.zeros(SIZE, np.uint8),
    )
    depth = triangulate(flat, rig)
    frames = pictures(shares(code, flat.column, flat.row))
    cues = dict(zip(NAMES, cues_of(frames, code, LEVELS, flat, depth, rig), strict=True))
    z_m = depth.depth_m.astype(float)
    camera, projector = rig.camera, rig.projector
    y = (np.arange(SIZE[0])[:, None] - camera.cy_px) / camera.fy_px
    row = projector.cy_px + projector.fy_px * y * z_m / (z_m + rig.T_proj_cam[2, 3])
    off_px = np.maximum(np.abs(80.0 - row), 1e-2)
    known = np.isfinite(z_m)
    assert known.any()
    np.testing.assert_allclose(2 ** cues["off the epipolar line"][known], off_px[known], rtol=1e-3)
    over_sigma = np.abs(80.0 - row) / 0.05
    far = known & (over_sigma > 1)
    np.testing.assert_allclose(
        2 ** cues["off the epipolar line over sigma"][far], over_sigma[far], rtol=1e-3
    )


def test_without_a_rig_and_a_second_axis_only_their_cues_are_missing():
    code = code_of("gray_phase", axes=("column",))
    column, row = plane()
    codes = code_map(column, np.full_like(row, np.nan))
    cues = named(pictures(shares(code, column, row)), code, codes)
    missing = {name for name, values in cues.items() if np.isnan(values).all()}
    assert missing == {
        name
        for name in NAMES
        if any(word in name for word in ("along", "epipolar", "of depth", "slope", "rival", "hand"))
    } - {"sigma along"}
