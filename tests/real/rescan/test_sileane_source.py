"""Reading of the Siléane and IPA layouts, with files written from their descriptions."""

import json
import pickle

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.source import SourceOptions

from .scene_files import CAMERA, POSE, SIDE_MM, cube_ply, png, true_depth_m, write_json

START_M, END_M = 0.3, 1.1
STEP_M = (END_M - START_M) / 65535
T_WORLD_CAM = rigid(
    axis_rotation("x", np.pi) @ axis_rotation("z", 0.5), np.array([-0.1, 0.05, 1.5])
)


def steps():
    value = np.rint((true_depth_m() - START_M) / STEP_M).astype(np.uint16)
    value[0, 0] = 65535
    return value


def refusal(folder, *words, **options):
    with pytest.raises(DatasetError) as caught:
        source = open_source(folder, SourceOptions(**options))
        for scene_id, image_id in source.images:
            source.read(scene_id, image_id)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def check(image):
    """Check depth and pose of the cube of `scene_files`."""
    assert np.isnan(image.depth_m[0, 0])
    assert np.nanmax(np.abs(image.depth_m - true_depth_m())) <= 0.51 * STEP_M
    assert image.step_m == pytest.approx(STEP_M)
    assert image.obj_id.tolist() == [1]
    assert np.allclose(image.T_cam_part[0], POSE, rtol=0, atol=1e-6)


# --- Siléane ------------------------------------------------------------------------------------


def write_sileane(folder, name="depth_gt"):
    # This quaternion (w x y z) is a rotation by pi about x, then by 0.5 about the new z.
    half = np.array([np.cos(0.25), np.sin(0.25)])
    quaternion = [0.0, half[0], -half[1], 0.0]
    params = {
        **{"width": [64], "height": [48], "fu": [90.0], "fv": [91.0], "cu": [31.0], "cv": [24.5]},
        **{"clip_start": [START_M], "clip_end": [END_M], "location": [-0.1, 0.05, 1.5]},
        "rotation": quaternion,
    }
    folder.mkdir(parents=True)
    lines = ["\t".join([key, *(f"{v:.12g}" for v in values)]) for key, values in params.items()]
    lines.insert(8, "# Location of the camera, expressed by a 3D translation vector.")
    (folder / "camera_params.txt").write_text("\n".join(lines) + "\n")
    T = T_WORLD_CAM @ POSE
    entry = {"R": T[:3, :3].tolist(), "t": T[:3, 3].tolist()}
    entry |= {"segmentation_id": 65535, "occlusion_rate": 0.1}
    for stem in ("bunny_000", "bunny_001"):
        png(folder / name / f"{stem}.PNG", steps())
        write_json(folder / f"gt/{stem}.json", [entry] if stem.endswith("1") else [])
        png(folder / f"rgb/{stem}.PNG", np.full((48, 64), 77, np.uint8))
    (folder / "mesh.ply").write_text(cube_ply(SIDE_MM / 1e3))
    return folder


def test_poses_of_a_sileane_scene_are_in_the_camera_frame(tmp_path):
    """Oracle: the camera-frame pose from which the absolute pose in the file was computed."""
    assert np.allclose(inverse(T_WORLD_CAM) @ T_WORLD_CAM @ POSE, POSE)
    source = pickle.loads(pickle.dumps(open_source(write_sileane(tmp_path / "bunny"))))
    assert (source.split, source.scenes, source.sensor) == ("bunny", {}, "")
    assert source.images == ((0, 0), (0, 1))
    check(source.read(0, 1))
    empty = source.read(0, 0)
    assert empty.obj_id.tolist() == [] and (empty.rgb == 77).all()
    assert empty.camera == CAMERA
    assert np.allclose(source.parts[1].mesh.extent_m, SIDE_MM / 1e3)
    assert source.parts[1].name == "bunny"


def test_ideal_depth_is_preferred_to_measured_depth(tmp_path):
    folder = write_sileane(tmp_path / "bunny", "depth")
    check(open_source(folder).read(0, 1))
    for stem in ("bunny_000", "bunny_001"):
        png(folder / f"depth_gt/{stem}.PNG", np.full((48, 64), 32768, np.uint16))
    middle_m = START_M + 32768 * STEP_M
    assert np.allclose(open_source(folder).read(0, 1).depth_m, middle_m)


def test_files_that_contradict_the_sileane_format_are_refused(tmp_path):
    folder = write_sileane(tmp_path / "bunny")
    params, gt = folder / "camera_params.txt", folder / "gt/bunny_001.json"
    text = params.read_text()
    for old, new, words in (
        ("fu\t90\n", "", ("fu", "required")),
        ("fu\t90\n", "fu\t-90\n", ("fu", "greater than 0")),
        ("fu\t90\n", "fu\twide\n", ("wide",)),
        ("width\t64", "width\t65", ("64 x 48", "65 x 48")),
        ("clip_end\t1.1", "clip_end\t0.2", ("clip_start",)),
    ):
        params.write_text(text.replace(old, new))
        refusal(folder, "camera_params.txt", *words)
    params.write_text(text)
    entry = json.loads(gt.read_text())[0]
    write_json(gt, [entry | {"R": (2 * np.eye(3)).tolist()}])
    refusal(folder, str(gt), "instance 0", "rotation")
    write_json(gt, [{"R": entry["R"]}])
    refusal(folder, str(gt), "0.t")
    gt.unlink()
    refusal(folder, str(gt), "missing")
    assert len(open_source(folder, SourceOptions(depth_only=True)).read(0, 1).obj_id) == 0
    (folder / "mesh.ply").write_text(cube_ply(SIDE_MM))
    refusal(folder, "mesh.ply", "60 m", "export it in m")
    (folder / "mesh.ply").unlink()
    refusal(folder, "mesh.ply", "--models")
    png(folder / "depth_gt/bunny_000.PNG", np.zeros((48, 64), np.uint8))
    refusal(folder, "bunny_000.PNG", "16 bits", depth_only=True)


# --- Fraunhofer IPA -----------------------------------------------------------------------------


def write_ipa(folder):
    """Write a dataset whose pictures are cut from 200 x 200 pixels: f = 90 px, axis at 99.5 px."""
    write_json(
        folder / "parameter.json",
        {
            "perspectiveAngle": 2 * np.degrees(np.arctan(100 / 90)),
            **{"clip_start": START_M, "clip_end": END_M, "number_cycles": 1},
            **{"resolutionX": 64, "resolutionY": 48, "resolution_big": 200},
            **{"pixelOffset_X_KoSyTopLeft": 68, "pixelOffset_Y_KoSyTopLeft": 75},
        },
    )
    T = np.diag([-1.0, -1.0, 1.0, 1.0]) @ POSE
    row = [1, 1, *T[:3, 3], *T[:3, :3].T.ravel(), 1.0, 1.0]
    empty = [0, 0, *np.zeros(3), *np.eye(3).ravel(), 0.0, 0.0]
    depth = steps()
    depth[1, 1] = 0
    for number, rows in (("000", [empty]), ("001", [empty, row])):
        png(folder / f"p_depth/cycle_0007/{number}_depth_uint16.png", depth)
        (folder / "gt/cycle_0007").mkdir(parents=True, exist_ok=True)
        lines = ["id,class,x,y,z,r", *(",".join(f"{v:.12g}" for v in row) for row in rows)]
        (folder / f"gt/cycle_0007/{number}.csv").write_text("\n".join(lines) + "\n")
    png(folder / "p_rgb/cycle_0007/001_rgb.png", np.full((48, 64, 3), (10, 20, 30), np.uint8))
    (folder / "mesh.ply").write_text(cube_ply(SIDE_MM / 1e3))
    return folder


def test_an_ipa_scene_is_converted_to_the_frame_of_opencv(tmp_path):
    source = pickle.loads(pickle.dumps(open_source(write_ipa(tmp_path / "gear"))))
    assert source.images == ((7, 0), (7, 1))
    image = source.read(7, 1)
    check(image)
    assert np.argwhere(np.isnan(image.depth_m)).tolist() == [[0, 0], [1, 1]]
    assert (image.rgb == (30, 20, 10)).all()
    camera = image.camera
    assert camera.fx_px == pytest.approx(90) and camera.fy_px == pytest.approx(90)
    assert (camera.cx_px, camera.cy_px) == (31.5, 24.5)
    assert source.read(7, 0).obj_id.tolist() == [] and source.read(7, 0).rgb is None
    (tmp_path / "gear/gt/cycle_0007/000.csv").unlink()
    assert source.read(7, 0).obj_id.tolist() == []


def test_points_from_ipa_agree_with_the_loop_over_pixels_in_its_own_code(tmp_path):
    """Oracle: the published loop, reimplemented. It rotates the square picture by half a turn, and
    a pixel's centre is half a pixel from its corner. To OpenCV's frame, x and y change sign.
    """
    image = open_source(write_ipa(tmp_path / "gear")).read(7, 1)
    row, column = 30, 10
    z = image.depth_m[row, column]
    i, j = 199 - (column + 68), 199 - (row + 75)
    metres_per_pixel = 2 * z * (100 / 90) / 200
    x, y = ((k + 0.5 - 100) * metres_per_pixel for k in (i, j))
    camera = image.camera
    assert -x == pytest.approx((column - camera.cx_px) / camera.fx_px * z)
    assert -y == pytest.approx((row - camera.cy_px) / camera.fy_px * z)


def test_files_that_contradict_the_ipa_format_are_refused(tmp_path):
    folder = write_ipa(tmp_path / "gear")
    path, table = folder / "parameter.json", folder / "gt/cycle_0007/001.csv"
    content = json.loads(path.read_text())
    for change, words in (
        ({"perspectiveAngle": 0}, ("orthographic", "p_depth")),
        ({"perspectiveAngle": "wide"}, ("perspectiveAngle",)),
        ({"resolutionX": 65}, ("65 x 48",)),
        ({"clip_start": 3.0}, ("clip_start",)),
    ):
        write_json(path, content | change)
        refusal(folder, "parameter.json", *words)
    write_json(path, content)
    text = table.read_text()
    table.write_text(text.replace(",1,1\n", ",1\n").replace("1,1,", "1,", 1)[:-60])
    refusal(folder, str(table))
    table.unlink()
    refusal(folder, str(table))
    (folder / "p_depth").rename(folder / "o_depth")
    refusal(folder, "orthographic")
    (folder / "p_depth").mkdir()
    refusal(folder, "no depth pictures")
