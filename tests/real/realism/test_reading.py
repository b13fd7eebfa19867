"""Reading of the same depth map from every file format, and errors about unreadable files."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.real.depth_file import FileOptions, read_intrinsics
from graycast.real.realism import read_scans

from .synthetic import K, plane, rays

SCALE_M = 1e-4


@pytest.fixture
def depth_m():
    """Return the depth of a tilted plane with a hole, in steps of 0.1 mm."""
    depth_m = np.round(plane(0.3, height_px=30, width_px=40) / SCALE_M) * SCALE_M
    depth_m[5:9, 7:12] = np.nan
    return depth_m


def ply(depth_m, form, *, info="obj_info num_cols 40\nobj_info num_rows 30\n", color=False):
    """Return an organised cloud [mm] as a scanner might write it."""
    point = np.nan_to_num(rays(*depth_m.shape) * depth_m[..., None] * 1e3).reshape(-1, 3)
    order = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}[form]
    kind = [(axis, order + "f4") for axis in "xyz"]
    kind += [(name, "u1") for name in ("red", "green", "blue")] if color else []
    table = np.zeros(len(point), dtype=kind)
    for i, axis in enumerate("xyz"):
        table[axis] = point[:, i]
    if color:
        table["red"], table["green"], table["blue"] = 30, 60, 90
    names = {"f4": "float", "u1": "uchar"}
    properties = "".join(f"property {names[code[-2:]]} {name}\n" for name, code in kind)
    head = f"ply\nformat {form} 1.0\n{info}element vertex {len(point)}\n{properties}"
    head += "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        body = "\n".join(" ".join(repr(float(v)) for v in row) for row in table).encode()
    else:
        body = table.tobytes()
    return head.encode() + body


def one(path, **options):
    (scan,) = read_scans([path], options=FileOptions(**options))
    return scan


def test_npy_and_png_files_give_the_same_map(tmp_path, depth_m):
    np.save(tmp_path / "a.npy", depth_m)
    steps = np.nan_to_num(depth_m / SCALE_M).round().astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), steps)
    np.testing.assert_allclose(one(tmp_path / "a.npy", K=K).depth_m, depth_m, rtol=1e-12)
    scan = one(tmp_path / "a.png", K=K, scale_m=SCALE_M)
    np.testing.assert_allclose(scan.depth_m, depth_m, rtol=1e-12)


def test_the_largest_number_in_depth_files_means_unknown_depth(tmp_path, depth_m):
    steps = np.nan_to_num(depth_m / SCALE_M).round().astype(np.uint16)
    steps[steps == 0] = 65535
    scene = tmp_path / "000000"
    (scene / "depth").mkdir(parents=True)
    cv2.imwrite(str(scene / "depth/000000.png"), steps)
    view = {"cam_K": K.ravel().tolist(), "depth_scale": SCALE_M * 1e3}
    (scene / "scene_camera.json").write_text(json.dumps({"0": view}))
    for scan in (one(scene / "depth/000000.png", K=K, scale_m=SCALE_M), one(scene)):
        np.testing.assert_allclose(scan.depth_m, depth_m, rtol=1e-12)


def test_a_depth_map_with_one_channel_is_read_as_a_plain_map(tmp_path, depth_m):
    np.save(tmp_path / "a.npy", depth_m[..., None])
    np.testing.assert_array_equal(one(tmp_path / "a.npy", K=K).depth_m, depth_m)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_an_organised_ply_gives_depth_and_camera(tmp_path, depth_m, form):
    (tmp_path / "a.ply").write_bytes(ply(depth_m, form))
    scan = one(tmp_path / "a.ply", scale_m=1e-3)
    np.testing.assert_allclose(scan.depth_m, depth_m, rtol=1e-6)
    np.testing.assert_allclose(scan.K, K, atol=1e-3)
    assert scan.gray is None


def test_the_brightness_of_a_coloured_ply_is_read(tmp_path, depth_m):
    (tmp_path / "a.ply").write_bytes(ply(depth_m, "binary_little_endian", color=True))
    np.testing.assert_allclose(one(tmp_path / "a.ply", scale_m=1e-3).gray, 60 / 255)


def test_pictures_and_reasons_are_matched_to_depth_files_by_their_order(tmp_path, depth_m):
    for i in range(2):
        np.save(tmp_path / f"{i}.npy", depth_m)
        cv2.imwrite(str(tmp_path / f"g{i}.png"), np.full((30, 40, 3), 51 * (i + 1), np.uint8))
        cv2.imwrite(str(tmp_path / f"r{i}.png"), np.full((30, 40), i, np.uint8))
    scans = list(
        read_scans(
            [tmp_path / "0.npy", tmp_path / "1.npy"],
            options=FileOptions(K=K),
            gray=[tmp_path / "g0.png", tmp_path / "g1.png"],
            reason=[tmp_path / "r0.png", tmp_path / "r1.png"],
            reason_names={1: "SHADOW"},
        )
    )
    assert [float(s.gray[0, 0]) for s in scans] == [pytest.approx(0.2), pytest.approx(0.4)]
    assert [int(s.reason[0, 0]) for s in scans] == [0, 1]


def bop_scene(folder, depth_m, suffix=""):
    steps = np.nan_to_num(depth_m / SCALE_M).round().astype(np.uint16)
    for name, image in {
        f"depth{suffix}": steps,
        f"gray{suffix}": np.full(steps.shape, 102, np.uint8),
        f"reason{suffix}": (steps == 0).astype(np.uint8),
    }.items():
        (folder / name).mkdir(parents=True)
        cv2.imwrite(str(folder / name / "000000.png"), image)
    view = {"0": {"cam_K": K.ravel().tolist(), "depth_scale": 0.1}}
    (folder / f"scene_camera{suffix}.json").write_text(json.dumps(view))


@pytest.mark.parametrize("level", ["", "train", "train/000003"])
def test_a_dataset_of_graycast_is_read_with_all_its_data(tmp_path, depth_m, level):
    scene = tmp_path / "train" / "000003"
    bop_scene(scene, depth_m, "_sl")
    bop_scene(scene, np.full((30, 40), 0.7))  # perfect depth, which must not be used
    (scene / "scene_sl.json").write_text('{"0": {"reasons": {"DECODED": 0, "SHADOW": 1}}}')
    T = np.eye(4)
    T[:3, 3] = [0.3, 0.0, 0.4]
    (tmp_path / "graycast.json").write_text(json.dumps({"rig": {"T_cam_proj": T.tolist()}}))
    scan = one(tmp_path / level)
    np.testing.assert_allclose(scan.depth_m, depth_m, rtol=1e-12)
    np.testing.assert_array_equal(scan.K, K)
    assert scan.gray[0, 0] == pytest.approx(0.4)
    assert scan.reason_names == {0: "DECODED", 1: "SHADOW"}
    assert scan.baseline_m == pytest.approx(0.5)


def test_another_bop_dataset_is_read_by_its_standard_names(tmp_path, depth_m):
    bop_scene(tmp_path / "test" / "000001", depth_m)
    scan = one(tmp_path)
    np.testing.assert_allclose(scan.depth_m, depth_m, rtol=1e-12)
    assert scan.reason is None


def test_files_in_a_folder_are_read_in_the_order_of_their_names(tmp_path, depth_m):
    for name in ("b", "a", "c"):
        np.save(tmp_path / f"{name}.npy", depth_m)
    assert [s.name[-5:] for s in read_scans([tmp_path], options=FileOptions(K=K))] == [
        "a.npy",
        "b.npy",
        "c.npy",
    ]


@pytest.mark.parametrize("suffix", [".npy", ".txt", ".json", "text", "camera", "list"])
def test_intrinsics_are_read_from_every_supported_format(tmp_path, suffix):
    path = tmp_path / f"K{suffix}"
    match suffix:
        case ".npy":
            np.save(path, K)
        case ".txt":
            np.savetxt(path, K)
        case ".json":
            path.write_text(json.dumps({"7": {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}}))
        case "camera":
            path = tmp_path / "camera.json"
            path.write_text('{"fx": 300.0, "fy": 300.0, "cx": 159.5, "cy": 119.5, "width": 320}')
        case "list":
            path = tmp_path / "K.json"
            path.write_text(json.dumps(K.tolist()))
        case "text":
            path = "300,300,159.5,119.5"
    np.testing.assert_allclose(read_intrinsics(str(path)), K)


@pytest.mark.parametrize("text", ["300,300", "nothing.json", "a,b,c,d", "0,0,1,1"])
def test_invalid_intrinsics_are_refused(text):
    with pytest.raises(DatasetError, match="give fx,fy,cx,cy"):
        read_intrinsics(text)


@pytest.mark.parametrize(
    "text", ["[[1, 2], [3, 4]]", "[1, 2, 3]", "[]", '[["a"]]', "[[1], [2, 3]]"]
)
def test_a_list_that_is_no_camera_matrix_is_refused(text, tmp_path):
    (tmp_path / "K.json").write_text(text)
    with pytest.raises(DatasetError, match="give fx,fy,cx,cy"):
        read_intrinsics(str(tmp_path / "K.json"))


def refusal(path, **options):
    with pytest.raises(DatasetError) as caught:
        list(read_scans([path], options=FileOptions(**options)))
    assert str(path.parent) in str(caught.value)
    return str(caught.value)


def test_missing_options_are_named(tmp_path, depth_m):
    np.save(tmp_path / "a.npy", depth_m)
    np.save(tmp_path / "i.npy", np.ones((4, 4), np.uint16))
    np.save(tmp_path / "mm.npy", 1e3 * depth_m)
    assert "give the intrinsics" in refusal(tmp_path / "a.npy")
    assert "give the scale" in refusal(tmp_path / "i.npy", K=K)
    assert "give a scale of 0.001" in refusal(tmp_path / "mm.npy", K=K)
    with pytest.raises(DatasetError, match="1 gray images for 2 depth files"):
        options = FileOptions(K=K)
        list(read_scans([tmp_path / "a.npy"] * 2, options=options, gray=[tmp_path / "g.png"]))


def test_an_unorganised_ply_is_refused_and_the_missing_data_are_named(tmp_path, depth_m):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(depth_m, "ascii", info=""))
    assert "obj_info num_cols" in refusal(path)
    assert one(path, scale_m=1e-3, size_px=(40, 30)).depth_m.shape == (30, 40)
    assert "has 1200 vertices, 40 x 31 pixels need 1240" in refusal(path, size_px=(40, 31))
    data = ply(depth_m, "binary_little_endian")
    path.write_bytes(data[:-100])
    assert "its vertices cannot be read (PLY is unexpected length!): export" in refusal(path)
    rows = ply(depth_m, "ascii").rsplit(b"\n", 1)[0]
    for end in (b"", b"\n0 0\n"):
        path.write_bytes(rows + end)
        assert "its rows are not the 1200 vertices that its header states" in refusal(path)
    path.write_bytes(rows + b"\n0 0 0 0\n")
    assert "its rows are not the 1200 vertices that its header states" in refusal(path)
    path.write_bytes(data.replace(b"format binary", b"format morse"))
    assert "format is morse_little_endian: choose one of binary_little_endian, " in refusal(path)
    path.write_bytes(data.replace(b"property float z", b"property float w"))
    assert "have no z" in refusal(path)
    path.write_bytes(b"solid cube")
    assert "is not a PLY" in refusal(path)


def test_a_ply_in_another_frame_gives_no_camera(tmp_path, depth_m):
    """Points are rotated by 20 degrees about y, so no camera projects them to their pixels."""
    path = tmp_path / "a.ply"
    data = ply(depth_m, "binary_little_endian")
    at = data.index(b"end_header\n") + len(b"end_header\n")
    point = np.frombuffer(data[at:], dtype="<f4").reshape(-1, 3)
    c, s = np.cos(0.35), np.sin(0.35)
    turned = (point @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T).astype("<f4")
    path.write_bytes(data[:at] + turned.tobytes())
    assert "px RMS from the best pinhole camera, and" in refusal(path, scale_m=1e-3)


@pytest.mark.slow
def test_a_picture_of_another_size_is_refused(tmp_path, depth_m):
    """A separate process has no checks of array annotations, as for users."""
    np.save(tmp_path / "a.npy", depth_m)
    np.save(tmp_path / "g.npy", np.zeros((3, 3)))
    call = (
        "import sys; from pathlib import Path; from graycast.real.realism import read_scans\n"
        "from graycast.real.depth_file import FileOptions, read_intrinsics\n"
        "a, g = map(Path, sys.argv[1:])\n"
        "files = FileOptions(K=read_intrinsics('1,1,0,0'))\n"
        "list(read_scans([a], options=files, gray=[g]))"
    )
    files = [str(tmp_path / name) for name in ("a.npy", "g.npy")]
    run = subprocess.run([sys.executable, "-c", call, *files], capture_output=True, text=True)
    assert "give pictures of the same scan" in run.stderr


def test_broken_files_are_refused_by_name(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    (tmp_path / "a.npy").write_bytes(b"no array")
    (tmp_path / "empty").mkdir()
    assert "not an image" in refusal(tmp_path / "a.png", K=K, scale_m=1.0)
    assert "cannot be read as NPY" in refusal(tmp_path / "a.npy", K=K)
    assert "no such file" in refusal(tmp_path / "b.png", K=K, scale_m=1.0)
    assert "neither depth files" in refusal(tmp_path / "empty", K=K)
