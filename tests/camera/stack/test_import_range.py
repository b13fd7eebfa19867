"""Without a stated working range, the range is what both devices of a calibration see."""

import cv2
import numpy as np
import pytest

from graycast.base.errors import ConfigError
from graycast.base.frames import inverse
from graycast.camera.rig_file import import_opencv

from .simulated import small_rig


def write(path, rig, T_proj_cam):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("cam_K", rig.camera.K)
    storage.write("pro_K", rig.projector.K)
    storage.write("cam_size", np.array([rig.camera.width_px, rig.camera.height_px]))
    storage.write("pro_size", np.array([rig.projector.width_px, rig.projector.height_px]))
    storage.write("R", np.ascontiguousarray(T_proj_cam[:3, :3]))
    storage.write("T", 1e3 * T_proj_cam[:3, 3])
    storage.release()


def sizes():
    return {"unit": "mm", "camera_size_px": None, "projector_size_px": None}


def test_the_default_range_is_where_camera_and_projector_see_a_common_point(tmp_path):
    """Oracle: intersections of the borders of both fields, in the plane of both optical axes."""
    rig = small_rig()
    write(tmp_path / "rig.yaml", rig, inverse(rig.T_cam_proj))
    imported = import_opencv(tmp_path / "rig.yaml", **sizes())
    camera_right = (rig.camera.width_px - 1) / 2 / rig.camera.fx_px
    edge = (rig.projector.width_px / 2) / rig.projector.fx_px
    # The projector is at x = 0.2 m, turned by 0.25 rad to the camera. Slope of its left border:
    left = np.tan(np.arctan(-edge) - 0.25)
    nearest_m = 0.2 / (camera_right - left)
    assert imported.near_m == pytest.approx(nearest_m, rel=0.03)
    assert imported.near_m < imported.far_m <= 20 * 0.2 + 1e-9
    stated = import_opencv(tmp_path / "rig.yaml", near_m=0.3, far_m=0.9, **sizes())
    assert (stated.near_m, stated.far_m) == (0.3, 0.9)


def test_devices_without_a_common_field_of_view_are_refused(tmp_path):
    rig = small_rig()
    T_proj_cam = inverse(rig.T_cam_proj)
    T_proj_cam[:3, :3] = np.diag([-1.0, 1.0, -1.0])  # back to back
    write(tmp_path / "rig.yaml", rig, T_proj_cam)
    with pytest.raises(ConfigError, match="have no common field of view"):
        import_opencv(tmp_path / "rig.yaml", **sizes())
