"""Rig files keep every bit, OpenCV calibrations keep their meaning, and bad files are named."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from graycast.base.errors import ConfigError
from graycast.base.frames import inverse, rigid, transform_points
from graycast.camera.rig_file import (
    import_opencv,
    load_scanner,
    missing_distortions,
    named_scanner,
    save_scanner,
)
from graycast.camera.rig_file.own import RigModel
from graycast.camera.scanner import Scanner, preset
from graycast.rig.optics import project
from graycast.rig.pair import PRESETS, preset_rig

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
SEA_SHELL = SHARED / "scans" / "sea_shell" / "calibration.yaml"
SCANNER_SIM = SHARED / "rigs" / "scanner_sim"

RANGE = {"near_m": 0.3, "far_m": 0.8}
NO_SIZES = {"camera_size_px": None, "projector_size_px": None}
CALIBRATION = {
    "cam_size": [640, 480],
    "cam_K": [[800.5, 0.0, 321.25], [0.0, 799.125, 238.5], [0.0, 0.0, 1.0]],
    "cam_kc": [-0.21, 0.14, -0.0009, 0.0013, -0.03],
    "pro_size": [1280, 720],
    "pro_K": [[1650.0, 0.0, 622.0], [0.0, 1719.0, 363.0], [0.0, 0.0, 1.0]],
    "pro_kc": [[-0.05], [0.3], [-0.0075], [-0.002]],
    "R": Rotation.from_euler("yxz", [-0.4, 0.05, 0.02]).as_matrix().tolist(),
    "T": [[-183.0], [-23.0], [-60.0]],
}
OTHER_KEYS = {
    "cam_K": ["M1", "K1", "cameraMatrix1"],
    "cam_kc": ["D1", "D1", "distCoeffs1"],
    "pro_K": ["M2", "K2", "cameraMatrix2"],
    "pro_kc": ["D2", "D2", "distCoeffs2"],
    "cam_size": ["cam_size", "image_size", "cam_size"],
    "pro_size": ["pro_size", "proj_size", "pro_size"],
}
# SLStudio and SLMaster write these keys.
UNREAD_KEYS = {
    "cam_K": ["Kc", "M1"],
    "cam_kc": ["kc", "D1"],
    "pro_K": ["Kp", "M4"],
    "pro_kc": ["kp", "D4"],
    "R": ["Rp", "Rlp"],
    "T": ["Tp", "Tlp"],
}


def write_file_storage(path, content):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in content.items():
        storage.write(key, np.array(value, dtype=np.float64))
    storage.write("stereo_rms", 0.4)
    storage.write("comment", "of no use here")
    storage.release()


def write(path, content):
    """Write the same numbers in one of the dialects that are read."""
    match path.name.split(".", 1)[1]:
        case "yaml":
            path.write_text(yaml.safe_dump(content))
        case "json":
            path.write_text(json.dumps(content))
        case "npz":
            np.savez(path, **{key: np.array(value) for key, value in content.items()})
        case _:
            write_file_storage(path, content)
    return path


def read(path, **changes):
    return import_opencv(path, **({"unit": None} | RANGE | NO_SIZES | changes))


def same(a, b):
    """Return whether two rigs or two scanners are equal."""
    if isinstance(a, Scanner):
        others = ("code", "sensor", "exposure", "decode", "filters", "faults")
        return same(a.rig, b.rig) and all(getattr(a, n) == getattr(b, n) for n in others)
    return a.T_cam_proj.tobytes() == b.T_cam_proj.tobytes() and all(
        getattr(a, name) == getattr(b, name) for name in a.__dataclass_fields__ if name[0] != "T"
    )


def awkward_rig(seed):
    """Return a rig of numbers that need all 17 digits, or an exponent."""
    rng = np.random.default_rng(seed)
    rig = preset_rig("like-phoxi-s")
    distortion = (-1 / 30, 1e-17 / 7, 1e-3 / 7, -(2**-40) / 3, 5e-324)
    turn = Rotation.from_euler("yxz", rng.uniform(-0.3, -0.1, 3))  # towards the scene
    T_cam_proj = rigid(turn.as_matrix(), rng.uniform([0.1, -0.02, -0.02], [0.15, 0.02, 0.02]))
    camera = replace(rig.camera, fx_px=800 + 1 / 3, cx_px=-1e-7 / 3, distortion=distortion)
    return replace(rig, T_cam_proj=T_cam_proj, camera=camera, near_m=1 / 3, picture_level=1 / 7)


@pytest.mark.parametrize("seed", range(5))
def test_a_saved_rig_is_read_back_to_the_last_bit(tmp_path, seed):
    rig = awkward_rig(seed)
    save_scanner(Scanner(rig=rig), tmp_path / "rig.yaml")
    assert same(load_scanner(tmp_path / "rig.yaml").rig, rig)


@pytest.mark.parametrize("name", PRESETS)
def test_saving_and_reading_does_not_change_a_preset(tmp_path, name):
    save_scanner(preset(name, "full"), tmp_path / "rig.yaml")
    assert same(load_scanner(tmp_path / "rig.yaml"), preset(name, "full"))


def test_saving_a_rig_writes_exactly_one_file(tmp_path):
    save_scanner(preset("paper"), tmp_path / "rig.yaml")
    save_scanner(preset("like-phoxi-s"), tmp_path / "rig.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]
    assert load_scanner(tmp_path / "rig.yaml").rig.name == "like-phoxi-s"


def test_a_rig_file_states_the_projector_s_pose_in_camera_coordinates(tmp_path):
    """The pose by hand: 0.2 m to the right of the camera, 0.7 m in front, -90 degrees about y."""
    save_scanner(preset("paper"), tmp_path / "rig.yaml")
    content = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    content["R_cam_proj"] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    content["t_cam_proj_m"] = [0.2, 0.0, 0.7]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(content))
    T_cam_proj = load_scanner(tmp_path / "rig.yaml").rig.T_cam_proj
    in_front_of_projector = transform_points(T_cam_proj, np.array([[0.0, 0.0, 1.0]]))
    assert in_front_of_projector.tolist() == [[-0.8, 0.0, 0.7]]


@pytest.mark.parametrize(
    "name", ["c.yaml", "c.json", "c.npz", "c.cv.yaml", "c.cv.yml", "c.cv.xml", "c.cv.json"]
)
def test_a_calibration_is_interpreted_as_opencv_interprets_it(tmp_path, name):
    """Oracle: cv2.projectPoints with R and T of the file maps points to projector pixels."""
    rig = read(write(tmp_path / name, CALIBRATION))
    point_m = np.random.default_rng(0).uniform([-0.05, -0.05, 0.4], [0.05, 0.05, 0.6], (50, 3))
    rotation = cv2.Rodrigues(np.array(CALIBRATION["R"]))[0]
    translation, K = np.array(CALIBRATION["T"]), np.array(CALIBRATION["pro_K"])
    expected, _ = cv2.projectPoints(
        1e3 * point_m, rotation, translation, K, np.array(CALIBRATION["pro_kc"])
    )
    pixel = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point_m))
    assert np.abs(pixel - expected[:, 0]).max() < 1e-7
    camera = (np.zeros(3), np.zeros(3), np.array(CALIBRATION["cam_K"]))
    expected, _ = cv2.projectPoints(point_m, *camera, np.array(CALIBRATION["cam_kc"]))
    assert np.abs(project(rig.camera, point_m) - expected[:, 0]).max() < 1e-7
    assert (rig.camera.width_px, rig.camera.height_px) == (640, 480)
    assert (rig.projector.width_px, rig.projector.height_px) == (1280, 720)
    assert (rig.near_m, rig.far_m) == (0.3, 0.8)


def renamed(keys, which):
    return {keys.get(key, [key] * 9)[which]: value for key, value in CALIBRATION.items()}


@pytest.mark.parametrize("which", range(3))
def test_opencv_s_names_for_keys_of_a_calibration_are_accepted(tmp_path, which):
    usual = read(write(tmp_path / "c.yaml", CALIBRATION))
    assert same(read(write(tmp_path / "c.xml", renamed(OTHER_KEYS, which))), usual)


@pytest.mark.parametrize("which", range(2))
def test_unknown_calibration_keys_are_refused_with_a_list_of_known_keys(tmp_path, which):
    path = write(tmp_path / "c.xml", renamed(UNREAD_KEYS, which))
    with pytest.raises(ConfigError, match=r"the file holds .*: name its key ") as error:
        read(path)
    assert_one_line_that_names(error, path)
    for key in set(CALIBRATION) | {word for keys in OTHER_KEYS.values() for word in keys}:
        assert re.search(rf"\b{key}\b", str(error.value))


def test_the_right_camera_in_a_calibration_is_not_taken_for_the_projector(tmp_path):
    """SLMaster has the right camera as M2 and the projector as M4."""
    content = renamed(UNREAD_KEYS, 1) | {"M2": CALIBRATION["cam_K"], "D2": CALIBRATION["cam_kc"]}
    content |= {"Rlr": np.eye(3).tolist(), "Tlr": [[90.0], [0.0], [0.0]]}
    with pytest.raises(ConfigError, match=r"no R .*name its key R;"):
        read(write(tmp_path / "c.xml", content))


def test_the_error_for_a_calibration_without_distortion_lists_its_keys(tmp_path):
    path = write(tmp_path / "c.yaml", CALIBRATION)
    assert missing_distortions(path) == ()
    other = {"cam_kc": "lensTermsA", "pro_kc": "lensTermsB"}
    content = {other.get(key, key): value for key, value in CALIBRATION.items()}
    camera, projector = missing_distortions(write(tmp_path / "c.yaml", content))
    assert "no distortion of the camera" in camera
    assert "no distortion of the projector" in projector
    assert "D1 or distCoeffs1 or cam_kc, and the file holds lensTermsA, lensTermsB" in camera
    alone = {key: value for key, value in CALIBRATION.items() if key != "pro_kc"}
    (projector,) = missing_distortions(write(tmp_path / "c.yaml", alone))
    assert "projector" in projector and "holds nothing else" in projector


def test_a_projector_that_faces_away_from_the_scene_is_refused(tmp_path):
    """After half a turn about y, the projector faces away from all that the camera sees."""
    save_scanner(preset("paper"), tmp_path / "rig.yaml")
    content = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    content["R_cam_proj"] = [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(
        ConfigError, match=r"no common field of view from 0\.458 to 1\.118 m: check"
    ):
        load_scanner(tmp_path / "rig.yaml")


def test_a_camera_that_is_200_000_pixels_wide_is_refused(tmp_path):
    save_scanner(preset("paper"), tmp_path / "rig.yaml")
    content = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    content["camera"]["width_px"] = 200_000
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=r"camera\.width_px is 200000: a picture has 1 to"):
        load_scanner(tmp_path / "rig.yaml")


@pytest.mark.parametrize(
    ("scale", "unit", "metres"), [(1, None, 1e-3), (1, "mm", 1e-3), (1e-3, None, 1), (1e-3, "m", 1)]
)
def test_the_unit_is_stated_or_inferred_from_the_length_of_t(tmp_path, scale, unit, metres):
    T = (np.array(CALIBRATION["T"]) * scale).tolist()
    rig = read(write(tmp_path / "c.yaml", CALIBRATION | {"T": T}), unit=unit)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(T) * metres)


def test_stated_picture_sizes_replace_the_sizes_in_the_calibration(tmp_path):
    path = write(tmp_path / "c.yaml", CALIBRATION)
    rig = read(path, camera_size_px=(641, 481), projector_size_px=(1281, 721))
    assert (rig.camera.width_px, rig.camera.height_px) == (641, 481)
    assert (rig.projector.width_px, rig.projector.height_px) == (1281, 721)


def test_rational_distortion_terms_of_zero_are_accepted(tmp_path):
    long = [[*CALIBRATION["cam_kc"], 0.0, 0.0, 0.0]]
    rig = read(write(tmp_path / "c.cv.yaml", CALIBRATION | {"cam_kc": long}))
    assert rig.camera.distortion == tuple(CALIBRATION["cam_kc"])
    assert rig.projector.distortion == (-0.05, 0.3, -0.0075, -0.002, 0.0)


def test_the_sea_shell_scanner_has_a_baseline_of_195_mm(tmp_path):
    if not SEA_SHELL.is_file():
        pytest.skip(f"the real calibration is not there: {SEA_SHELL}")
    rig = read(SEA_SHELL)
    assert rig.baseline_m == pytest.approx(0.195, abs=0.001)
    assert (rig.camera.width_px, rig.camera.height_px) == (2592, 1944)
    assert (rig.projector.width_px, rig.projector.height_px) == (1280, 800)
    assert rig.T_cam_proj[0, 3] > 0.1  # the projector is to the camera's right
    sized = read(SEA_SHELL, projector_size_px=(1280, 720))
    assert (sized.projector.width_px, sized.projector.height_px) == (1280, 720)
    save_scanner(Scanner(rig=rig), tmp_path / "rig.yaml")
    assert same(load_scanner(tmp_path / "rig.yaml").rig, rig)


def test_the_sea_shell_cloud_is_visible_to_camera_and_projector():
    """The author's cloud is in camera coordinates [mm] with y and z negated."""
    cloud = SEA_SHELL.with_name("reference_cloud.ply")
    if not cloud.is_file():
        pytest.skip(f"the real cloud is not there: {cloud}")
    trimesh = pytest.importorskip("trimesh")
    rig = read(SEA_SHELL, projector_size_px=(1280, 720))
    point_m = np.array(trimesh.load(cloud).vertices)[::50] * [1e-3, -1e-3, -1e-3]
    for optics, point in (
        (rig.camera, point_m),
        (rig.projector, transform_points(inverse(rig.T_cam_proj), point_m)),
    ):
        pixel = project(optics, point)
        inside = (pixel > -0.5) & (pixel < [optics.width_px - 0.5, optics.height_px - 0.5])
        assert inside.all(axis=1).mean() > 0.99


def test_a_calibration_of_a_single_device_is_refused():
    if not SCANNER_SIM.is_dir():
        pytest.skip(f"the measured scanner is not there: {SCANNER_SIM}")
    with pytest.raises(ConfigError, match="camera and projector in one file"):
        read(SCANNER_SIM / "camera_geometry.json")


SKEWED = [[800.0, 0.5, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]]
BAD_CALIBRATIONS = {
    "no K": ({"cam_K": None}, "no camera matrix .*: name its key M1 or K1"),
    "no R": ({"R": None}, "no R .*: name its key R;"),
    "K of wrong shape": ({"pro_K": [[1.0, 0.0], [0.0, 1.0]]}, r"pro_K has the shape \(2, 2\)"),
    "T of wrong shape": ({"T": [[1.0, 2.0]]}, r"T has the shape \(1, 2\)"),
    "R stretched": (
        {"R": np.diag([1.0, 1.0, 1.01]).tolist()},
        r"R is not .*det 1\.01.*orth.*0\.02",
    ),
    "R mirrored": ({"R": np.diag([1.0, 1.0, -1.0]).tolist()}, "R is not a rotation .det -1"),
    "skew": ({"cam_K": SKEWED}, "cam_K has the skew 0.5"),
    "K transposed": ({"cam_K": np.transpose(CALIBRATION["cam_K"]).tolist()}, "not a camera matrix"),
    "no baseline": ({"T": [0.0, 0.0, 0.0]}, "T is zero: .*baseline"),
    "unit open": ({"T": [5.0, 0.0, 0.0]}, "T has length 5: state its unit"),
    "no size": (
        {"pro_size": None},
        "the projector image size is missing: add proj_size or pro_size: .width",
    ),
    "broken size": ({"cam_size": [640.5, 480]}, "cam_size is .640.5, 480.*width, height"),
    "NaN": ({"cam_kc": [0.1, float("nan"), 0.0, 0.0]}, "cam_kc has numbers that are not finite"),
    "words": ({"T": ["far", "away", "left"]}, "T is not an array of numbers"),
    "ragged": ({"R": [[1.0], [0.0, 1.0]]}, "R is not an array of numbers"),
    "3 terms": ({"cam_kc": [0.1, 0.1, 0.1]}, "cam_kc has 3 terms: give"),
    "rational": ({"cam_kc": [0, 0, 0, 0, 0, 0.1, 0, 0]}, "cam_kc has rational.*calibrate with"),
    "folds over": ({"cam_kc": [-9.0, 0, 0, 0, 0]}, "camera: distortion .* has no inverse"),
    "twice": ({"K1": CALIBRATION["cam_K"]}, "K1 and cam_K both state the camera matrix: keep one"),
}


def assert_one_line_that_names(error, path):
    text = str(error.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text.removeprefix(str(path))) < 400


@pytest.mark.parametrize("case", BAD_CALIBRATIONS)
def test_a_bad_calibration_is_refused_with_file_key_and_remedy(tmp_path, case):
    change, message = BAD_CALIBRATIONS[case]
    content = {key: value for key, value in (CALIBRATION | change).items() if value is not None}
    path = write(tmp_path / "c.yaml", content)
    with pytest.raises(ConfigError, match=message) as error:
        read(path)
    assert_one_line_that_names(error, path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"unit": "m"}, "baseline is 194 m: give T in metres"),
        ({"unit": "ft"}, "no unit 'ft': choose one of m, cm, mm, inch"),
        ({"near_m": 0.9}, "0 < near_m < far_m"),
        ({"camera_size_px": (0, 480)}, "width_px is 0: it should be greater"),
    ],
)
def test_bad_options_for_a_good_calibration_are_refused(tmp_path, changes, message):
    path = write(tmp_path / "c.yaml", CALIBRATION)
    with pytest.raises(ConfigError, match=message) as error:
        read(path, **changes)
    assert_one_line_that_names(error, path)


def test_a_calibration_in_metres_instead_of_millimetres_is_noticed(tmp_path):
    path = write(tmp_path / "c.yaml", CALIBRATION | {"T": [0.2, 0.0, 0.0]})
    with pytest.raises(ConfigError, match=r"T in mm gives a baseline of 0\.2 mm"):
        read(path, unit="mm")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.yaml", "cam_K: [1, 2", "is not YAML in line"),
        ("c.yaml", "just words", "holds no keys"),
        ("c.yaml", "%YAML:1.0\n---\ncam_K: !!opencv-matrix\n   rows: 3\n", "OpenCV cannot|matrix"),
        ("c.xml", "<?xml version='1.0'?>\n<opencv_storage><a>", "OpenCV cannot parse it"),
        ("c.json", '{"K1": [1, 2', r"is not JSON \(EOF .* at line 1"),
        ("c.json", "[1, 2]", "holds no keys"),
        ("c.npz", "no zip", "is not an NPZ file"),
    ],
)
def test_a_file_without_a_calibration_is_refused(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        read(path)
    assert_one_line_that_names(error, path)


@pytest.mark.parametrize("name", ["gone.yaml", "gone.npz", "gone.xml", "gone.json"])
def test_the_error_for_a_missing_calibration_names_the_file(tmp_path, name):
    for reader in (read, load_scanner) if name.endswith("yaml") else (read,):
        with pytest.raises(ConfigError, match="no such file: check the path") as error:
            reader(tmp_path / name)
        assert_one_line_that_names(error, tmp_path / name)


def set_key(*path_and_value):
    def change(content):
        *path, last, value = path_and_value
        for key in path:
            content = content[key]
        content[last] = value

    return change


def drop_key(*path):
    def change(content):
        for key in path[:-1]:
            content = content[key]
        del content[path[-1]]

    return change


BAD_RIGS = {
    "unknown key": (set_key("basline", 1), "unknown key basline: the keys are code, exposure"),
    "unknown optics key": (
        set_key("camera", "fx", 800),
        "unknown key camera.fx: the keys are width_px.*fx_px",
    ),
    "missing key": (drop_key("projector", "cy_px"), "projector.cy_px is missing: add it"),
    "no camera": (drop_key("camera"), "camera is missing"),
    "NaN": (set_key("camera", "fx_px", float("nan")), "camera.fx_px is nan: it should be"),
    "negative": (set_key("near_m", -1.0), "near_m is -1.0: it should be greater than 0"),
    "word": (set_key("far_m", "far"), "far_m is 'far': it should be a number"),
    "half a pixel": (set_key("camera", "width_px", 10.5), "camera.width_px is 10.5"),
    "R not a rotation": (
        set_key("R_cam_proj", [[1, 0, 0], [0, 1, 0], [0, 0, 2]]),
        "R_cam_proj is not a rotation .det 2, orthogonality error 3",
    ),
    "R of wrong shape": (set_key("R_cam_proj", [[1, 0, 0], [0, 1, 0]]), "R_cam_proj.2 is missing"),
    "no baseline": (
        set_key("t_cam_proj_m", [0, 0, 0]),
        "camera and projector have the same position: give them a baseline",
    ),
    "millimetres": (
        set_key("t_cam_proj_m", [230, 0, 0]),
        "m: give T in metres, not in millimetres",
    ),
    "range": (set_key("far_m", 0.1), "0 < near_m < far_m"),
    "weights": (set_key("band_weights", [1, 1, 1]), "whose sum is 1"),
    "four terms": (set_key("camera", "distortion", [0, 0, 0, 0]), "camera.distortion.4 is missing"),
    "folds over": (set_key("camera", "distortion", [-9, 0, 0, 0, 0]), "camera: .*no inverse"),
}


@pytest.mark.parametrize("case", BAD_RIGS)
def test_a_bad_rig_file_is_refused_with_file_key_and_remedy(tmp_path, case):
    change, message = BAD_RIGS[case]
    path = tmp_path / "rig.yaml"
    save_scanner(preset("like-phoxi-s"), path)
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=message) as error:
        load_scanner(path)
    assert_one_line_that_names(error, path)


def test_a_rig_file_with_a_repeated_key_is_refused(tmp_path):
    path = tmp_path / "rig.yaml"
    save_scanner(preset("paper"), path)
    path.write_text(path.read_text() + "near_m: 0.5\n")
    with pytest.raises(ConfigError, match="near_m is given twice") as error:
        load_scanner(path)
    assert_one_line_that_names(error, path)


def test_a_calibration_in_place_of_a_rig_file_is_recognised(tmp_path):
    path = write(tmp_path / "c.cv.yaml", CALIBRATION)
    with pytest.raises(ConfigError, match=r"looks like an OpenCV calibration.*import it"):
        load_scanner(path)


def test_binary_data_and_a_folder_are_refused_as_a_rig_file(tmp_path):
    (tmp_path / "rig.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConfigError, match="is not a text file"):
        load_scanner(tmp_path / "rig.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scanner(tmp_path)


def test_saving_a_rig_into_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        save_scanner(preset("paper"), tmp_path / "gone" / "rig.yaml")
    assert list(tmp_path.iterdir()) == []


def test_a_configuration_may_name_a_preset_or_a_rig_file_next_to_it(tmp_path):
    rig = awkward_rig(seed=0)
    save_scanner(Scanner(rig=rig), tmp_path / "mine.yaml")
    assert same(named_scanner("mine.yaml", folder=tmp_path).rig, rig)
    assert same(named_scanner(str(tmp_path / "mine.yaml"), folder=Path("elsewhere")).rig, rig)
    assert same(named_scanner("like-phoxi-m", folder=tmp_path), preset("like-phoxi-m"))
    assert named_scanner("paper", folder=tmp_path, resolution="full").rig.camera.width_px == 2064


@pytest.mark.parametrize(
    ("text", "resolution", "message"),
    [
        (
            "phoxi-z",
            "low",
            "no rig 'phoxi-z': choose one of paper, like-phoxi-s, like-phoxi-m, .*, or",
        ),
        ("gone.yaml", "low", "gone.yaml: no such file"),
        ("paper", "medium", "no resolution 'medium': choose one of small, low, full"),
    ],
)
def test_the_error_for_an_unknown_rig_name_lists_the_presets(tmp_path, text, resolution, message):
    with pytest.raises(ConfigError, match=message):
        named_scanner(text, folder=tmp_path, resolution=resolution)


def test_the_schema_has_exactly_the_keys_of_a_saved_rig(tmp_path):
    save_scanner(preset("paper"), tmp_path / "rig.yaml")
    content, schema = (
        yaml.safe_load((tmp_path / "rig.yaml").read_text()),
        RigModel.model_json_schema(),
    )
    omitted = {"contrast_ratio", "line_noise_length_m"}, {"focus_m", "falloff"}  # infinite, off
    assert set(schema["properties"]) == set(content) | omitted[0]
    optics = schema["$defs"]["OpticsModel"]["properties"]
    assert set(optics) == set(content["camera"]) | omitted[1]
    assert schema["additionalProperties"] is False
    json.dumps(schema)
