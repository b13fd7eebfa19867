"""The region from which the exposure is metered."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.frames import transform_points
from graycast.camera.exposure import ExposureSpec
from graycast.cell.metering import metered_region
from graycast.cell.resolve import load_cell
from graycast.rig.optics import picture_rays
from graycast.world.scene import bin_of


def test_metered_pixels_are_those_whose_rays_meet_the_inside_of_the_bin(tmp_path):
    """Oracle: the slab method for the box, which shares no code with the projected hull."""
    scene = load_cell(write_cell(tmp_path)).scene
    length_m, width_m, height_m = bin_of(scene).inner_m
    ray = picture_rays(scene.rig.camera) @ scene.T_world_cam[:3, :3].T
    start = transform_points(scene.T_world_cam, np.zeros((1, 3)))[0]
    low = np.array([-length_m / 2, -width_m / 2, 0])
    high = np.array([length_m / 2, width_m / 2, height_m])
    with np.errstate(divide="ignore"):
        slab = np.stack([(low - start) / ray, (high - start) / ray])
    meets = slab.min(axis=0).max(axis=-1) <= slab.max(axis=0).min(axis=-1)
    region = metered_region(scene, ExposureSpec(auto=True))
    assert region is not None
    camera = scene.rig.camera
    border_px = 2 * (camera.width_px + camera.height_px)
    assert (region != meets).sum() < 1.5 * border_px
    assert region.any()
    assert (region & meets).sum() > 0.9 * meets.sum()


def test_a_scene_without_a_bin_has_no_metered_region(tmp_path):
    scene = replace(load_cell(write_cell(tmp_path)).scene, bin=None)
    assert metered_region(scene, ExposureSpec(auto=True)) is None


@pytest.mark.parametrize("exposure", [ExposureSpec(), ExposureSpec(exposure_s=0.01)])
def test_fixed_exposures_compute_no_metered_region(tmp_path, monkeypatch, exposure):
    scene = load_cell(write_cell(tmp_path)).scene
    monkeypatch.setattr(cv2, "fillConvexPoly", None)
    assert metered_region(scene, exposure) is None
