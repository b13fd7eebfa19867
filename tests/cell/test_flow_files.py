"""The flow in a dataset: the closed form of a belt's motion, another reader, and damage."""

import json

import cv2
import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.errors import DatasetError
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.dataset.check.raw_check import raw_problems
from graycast.dataset.files import records
from graycast.dataset.files.safe_reading import Unreadable, read_json
from graycast.dataset.files.scene_folder import SceneFolder
from graycast.dataset.write.flow import flow_files, read_flow
from graycast.dataset.write.raw import raw_facts_of

BELT_M_S, PICTURE_S = np.array([0.3, -0.15, 0.05]), 0.02


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Return a scene with two images, whose second picture has the time of the ground truth."""
    folder = tmp_path_factory.mktemp("flow")
    motion = {
        "belt_m_s": BELT_M_S.tolist(),
        "picture_s": PICTURE_S,
        "truth_picture": 1,
        "flow": True,
        "render_px": 100,
    }
    code = {"axes": ["column"], "codec": "gray"}
    views = [{"tilt_deg": 0}, {"tilt_deg": 30}]
    cell = write_cell(folder, scenes=1, motion=motion, code=code, views=views)
    assert main(["generate", str(cell), "--out", str(folder / "out"), "--device", "cpu"]) == 0
    return folder / "out/train/000000"


def stored(path):
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_the_flow_of_a_belt_is_that_of_a_translation_before_a_pinhole(scene, number):
    """Oracle: the depth, the pose and the intrinsics of the BOP files, read without our code."""
    view = json.loads((scene / "scene_camera.json").read_bytes())[str(number)]
    (fx, _, cx), (_, fy, cy), _ = np.reshape(view["cam_K"], (3, 3))
    z_mm = stored(scene / f"depth/{number:06d}.png") * view["depth_scale"]
    has_depth = z_mm > 0
    y, x = np.nonzero(has_depth)
    z_mm = z_mm[has_depth]
    pictures = sorted((scene / "flow").glob(f"{number:06d}_*"))
    assert len(pictures) == json.loads((scene / "manifest.json").read_bytes())["motion"]["pictures"]
    longest_px = 0.0
    for picture, path in enumerate(pictures):
        time_s = PICTURE_S * (picture - 1)
        dx, dy, dz = np.reshape(view["cam_R_w2c"], (3, 3)) @ BELT_M_S * 1e3 * time_s
        x_then = fx * ((x - cx) / fx * z_mm + dx) / (z_mm + dz) + cx
        y_then = fy * ((y - cy) / fy * z_mm + dy) / (z_mm + dz) + cy
        known, green, red = stored(path)[has_depth].T.astype(np.float64)
        assert (known == 1).all()
        # The files round flow to 1/64 px, and depth to a step, which moves points by 0.002 px.
        for channel, flow_px in ((red, x_then - x), (green, y_then - y)):
            assert np.abs((channel - 32768) / 64 - flow_px).max() < 1 / 128 + 0.002
        longest_px = max(longest_px, np.hypot(x_then - x, y_then - y).max())
    assert longest_px > 5


@pytest.mark.slow
def test_each_image_has_the_times_of_its_own_pictures(scene):
    exposures_s = []
    for number in (0, 1):
        facts = raw_facts_of(scene, number=number)
        assert facts.motion.exposure_s == [facts.exposure_s]
        exposures_s.append(facts.exposure_s)
    assert exposures_s[0] != exposures_s[1]


@pytest.mark.slow
def test_a_dataset_with_flow_is_valid_and_damage_is_detected(scene):
    assert validate(scene.parents[1]) == ()
    camera = read_json(scene.parents[1] / "camera.json", records.Camera)
    gray, reason = (stored(scene / f"{name}_sl/000001.png") for name in ("gray", "reason"))

    def problem(name, image):
        path = scene / "flow" / name
        content = path.read_bytes()
        path.unlink()
        if image is not None:
            cv2.imwrite(str(path), image)
        text = " ".join(raw_problems(SceneFolder(scene), 1, camera, gray=gray, reason=reason))
        path.write_bytes(content)
        return text

    first = stored(scene / "flow/000001_000000.png")
    assert "manifest.json states" in problem("000001_000003.png", None)
    assert "no flow in pixels with a depth" in problem("000001_000003.png", 0 * first)
    assert "picture of the ground truth" in problem("000001_000001.png", first)
    assert "must be uint16" in problem("000001_000002.png", first[..., 0])
    assert "the camera has" in problem("000001_000002.png", first[:-1])


def test_flow_is_read_back_within_half_a_step_and_a_larger_one_is_refused(tmp_path):
    flow_px = np.random.default_rng(0).uniform(-500, 500, (2, 5, 7, 2))
    flow_px[1, 2, 3] = np.nan
    (tmp_path / "flow_left").mkdir()
    for name, content in flow_files(flow_px, sensor="left", number=4):
        (tmp_path / name).write_bytes(content)
    for k in range(2):
        back = read_flow(tmp_path, k, sensor="left", number=4)
        assert np.allclose(back, flow_px[k], atol=1 / 128, rtol=0, equal_nan=True)
    with pytest.raises(Unreadable, match=r"flow_left/000004_000002\.png is missing"):
        read_flow(tmp_path, 2, sensor="left", number=4)
    with pytest.raises(DatasetError, match="a flow of 513 px does not fit"):
        list(flow_files(np.full((1, 2, 2, 2), -513.0), sensor="", number=0))
