"""A bag gives a program the stored pictures, and the frames of the scanner that took them."""

import math
import sqlite3
import time

import cv2
import numpy as np
import pictured
import pytest
from several_pictures import SCENES, several  # noqa: F401
from simulated_dataset import SCALE_MM, write_dataset
from small_cell import write_cell

from graycast.base.errors import ArgumentError, ScannerError
from graycast.cell.bag_scanner import BagScanner
from graycast.cell.generate import generate
from graycast.cell.resolve import load_cell
from graycast.cell.virtual_scanner import VirtualScanner
from graycast.dataset.export import Options, export

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
IDS, SEED = (0, 3, 4), 5


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    return out, write_dataset(out, IDS)


@pytest.fixture(scope="module", params=("ros2bag", "mcap"))
def bag(request, dataset, tmp_path_factory):
    return exported(dataset, tmp_path_factory.mktemp("bag") / "bag", format=request.param)


def exported(dataset, out, **options):
    export(dataset[0], out, Options(**options))
    return out / "train"


def frames(scanner, number):
    with scanner:
        return [scanner.trigger() for _ in range(number)]


def png(dataset, scene_id, name):
    path = dataset / "train" / f"{scene_id:06d}" / name / "000000.png"
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return image if image.ndim == 2 else image[..., ::-1]


def same(one, other):
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


# --- frames --------------------------------------------------------------------------------------


def test_the_frames_of_a_bag_are_the_stored_pictures_bit_for_bit_in_the_order_of_time(bag, dataset):
    """Oracle: OpenCV reads the PNGs, and the scale of the dataset gives depth; K is the rig's."""
    for k, frame in enumerate(frames(BagScanner(bag), len(IDS))):
        steps = png(dataset[0], IDS[k], "depth_sl")
        depth_m = np.where(steps > 0, steps * SCALE_MM / 1e3, np.nan).astype(np.float32)
        assert same(frame.depth_m, depth_m)
        for name, folder in (("gray", "gray_sl"), ("rgb", "rgb"), ("reason", "reason_sl")):
            assert same(getattr(frame, name), png(dataset[0], IDS[k], folder)), name
        v, u = np.indices(depth_m.shape)
        K = dataset[1][IDS[k]].scene.rig.camera.K
        ray = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 0 * u + 1.0], axis=-1)
        np.testing.assert_allclose(frame.points, ray * depth_m[..., None], rtol=1e-6)
        assert np.array_equal(frame.K, K) and not frame.camera.has_distortion
        assert (frame.index, frame.time_s) == (k, float(k))
        assert frame.sigma_m is frame.p_wrong is frame.pictures is None
        assert math.isnan(frame.duration_s)


@pytest.mark.slow
def test_each_scanner_of_a_bag_has_its_own_frames_poses_and_clock(several, tmp_path):  # noqa: F811
    """Each scene has two pictures of `left`, then two of `right`, one second after each other."""
    out, samples = several
    export(out, tmp_path / "bag", Options(format="mcap"))
    for name, first in ((None, 0), ("right", 2)):
        with BagScanner(tmp_path / "bag/train", name=name) as scanner:
            T_world_cam = samples[SCENES[0]][first].scene.T_world_cam
            np.testing.assert_allclose(scanner.T_world_cam, T_world_cam, atol=1e-9)
            for scene, image in ((0, 0), (0, 1), (1, 0), (1, 1)):
                frame, sample = scanner.trigger(), samples[SCENES[scene]][first + image]
                assert same(frame.gray, sample.gray) and same(frame.rgb, sample.rgb)
                np.testing.assert_allclose(scanner.T_world_cam, sample.scene.T_world_cam, atol=1e-9)
                assert frame.time_s == 4 * scene + image
    with pytest.raises(ArgumentError, match=r"name is 'top': .*train has left, right"):
        BagScanner(tmp_path / "bag/train", name="top").connect()


@pytest.mark.slow
@pytest.mark.parametrize("exposure", [{}, {"factors": [1, 4]}, {"auto": True}, "own code"])
def test_the_first_frame_of_a_virtual_scanner_comes_back_from_a_bag(
    tmp_path, exposure, mitsuba_renderer, monkeypatch
):
    """Only depth and the probability that it is wrong are rounded, to the steps of the dataset."""
    own = exposure == "own code"
    settings = {"exposure": {} if own else exposure, "decode": {"max_p_wrong": 0.5}}
    cell = load_cell(write_cell(tmp_path, **settings))
    if own:
        cell = cell.with_own(code=cell.scanner.light_code())
    with VirtualScanner(cell, seed=SEED, device=mitsuba_renderer.device) as scanner:
        taken = scanner.trigger()
    generate(cell, tmp_path / "out", scenes=1, seed=SEED, device=mitsuba_renderer.device)
    export(tmp_path / "out", tmp_path / "bag", Options(format="mcap"))
    pauses, start_s = [], time.perf_counter()
    monkeypatch.setattr(time, "sleep", pauses.append)
    with BagScanner(tmp_path / "bag/train", readout_s=10.0) as waiting:
        waited = waiting.trigger(wait=True)
    spent_s = time.perf_counter() - start_s
    assert waited.duration_s > 100 and waited.duration_s - spent_s <= pauses[0] < waited.duration_s
    with BagScanner(tmp_path / "bag/train") as replayed:
        frame = replayed.trigger()
        np.testing.assert_allclose(replayed.T_world_cam, scanner.T_world_cam, atol=1e-9)
    for name in ("gray", "rgb", "reason", "K"):
        assert same(getattr(frame, name), getattr(taken, name)), name
    np.testing.assert_allclose(frame.depth_m, taken.depth_m, atol=0.51e-4)
    np.testing.assert_allclose(frame.p_wrong, np.clip(taken.p_wrong, 1e-4, 1), rtol=0.02)
    assert (frame.index, frame.time_s, frame.pictures) == (0, 0, taken.pictures)
    assert frame.duration_s == pytest.approx(taken.duration_s, rel=1e-12)


@pytest.mark.slow
def test_a_bag_keeps_the_lens_and_its_perfect_depth_has_no_reasons(tmp_path):
    """Oracle: OpenCV projects each point onto its pixel."""
    pictured.write_dataset(tmp_path / "out", (0,), pictured.lensed_rig())
    export(tmp_path / "out", tmp_path / "bag", Options(format="ros2bag", depth="perfect"))
    (frame,) = frames(BagScanner(tmp_path / "bag/train"), 1)
    known = np.isfinite(frame.depth_m)
    points = frame.points[known].astype(float)
    lens = np.array(frame.camera.distortion)
    pixel = cv2.projectPoints(points, np.zeros(3), np.zeros(3), frame.K, lens)[0][:, 0]
    assert any(lens) and known.mean() > 0.9 and frame.reason is None
    assert np.abs(pixel - np.argwhere(known)[:, ::-1]).max() < 1e-2


@pytest.mark.slow
def test_a_bag_with_gray_pictures_has_no_colour(dataset, tmp_path):
    bag = exported(dataset, tmp_path / "bag", format="mcap", image="gray")
    (first,) = frames(BagScanner(bag), 1)
    assert first.rgb is None and same(first.gray, png(dataset[0], IDS[0], "gray_sl"))


# --- errors --------------------------------------------------------------------------------------


def test_the_end_of_a_bag_is_an_error_and_a_new_connection_begins_again(bag):
    scanner = BagScanner(str(bag))
    first, *_ = frames(scanner, len(IDS))
    with scanner:
        assert same(scanner.trigger().depth_m, first.depth_m)
        scanner.connect()  # This has no effect.
        assert [scanner.trigger().index for _ in IDS[1:]] == [1, 2]
        for _ in range(2):
            with pytest.raises(ScannerError, match=r"no further picture: call disconnect\(\) and"):
                scanner.trigger()


def test_a_setting_is_refused_because_the_pictures_exist(bag):
    with BagScanner(bag) as scanner:
        with pytest.raises(ScannerError, match=r"exposure\.auto cannot be True: the pictures of"):
            scanner.set("exposure.auto", True)


def test_a_bag_that_is_not_connected_gives_neither_frame_nor_pose(bag):
    scanner = BagScanner(bag)
    for call in (scanner.trigger, lambda: scanner.T_world_cam):
        with pytest.raises(ScannerError, match=r"train is not connected: call connect\(\) first"):
            call()


@pytest.mark.slow
def test_a_bag_without_depth_names_the_topic(dataset, tmp_path):
    bag = exported(dataset, tmp_path / "bag", format="ros2bag", depth="none")
    with pytest.raises(ScannerError, match="has no topic SCANNER/depth/image_raw: export"):
        BagScanner(bag).connect()


def test_a_folder_or_a_file_that_is_no_bag_is_refused(bag, tmp_path):
    (file,) = bag.glob("train.*")
    (tmp_path / file.name).write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    for wrong in (bag.parent, bag / "nothing", tmp_path / file.name):
        with pytest.raises(ScannerError, match=r"is no bag that can be read .*: give the folder"):
            BagScanner(wrong).connect()
    assert len(frames(BagScanner(file), len(IDS))) == len(IDS)


def test_changed_bytes_in_a_picture_are_damage_and_not_the_end_of_the_bag(bag, tmp_path):
    (file,) = bag.glob("train.*")
    content = bytearray(file.read_bytes())
    place = len(content) * 9 // 10
    content[place : place + 4000] = bytes(4000)
    (tmp_path / file.name).write_bytes(content)
    with pytest.raises(ScannerError, match=r"train\.\w+: is damaged \(.*\): export"):
        frames(BagScanner(tmp_path / file.name), len(IDS))


@pytest.mark.slow
def test_a_picture_without_intrinsics_names_the_missing_topic(dataset, tmp_path):
    bag = exported(dataset, tmp_path / "bag", format="ros2bag")
    with sqlite3.connect(bag / "train.db3") as database:
        database.execute(
            "DELETE FROM messages WHERE topic_id = "
            "(SELECT id FROM topics WHERE name = '/scanner/depth/camera_info')"
        )
    database.close()
    with pytest.raises(ScannerError, match="no message of /scanner/depth/camera_info at the time"):
        BagScanner(bag).connect()


@pytest.mark.slow
def test_a_bag_of_real_pictures_has_frames_but_no_pose(tmp_path):
    pictured.write_dataset(tmp_path / "out", (0,))
    pictured.forget(tmp_path / "out")
    export(tmp_path / "out", tmp_path / "bag", Options(format="ros2bag"))
    with BagScanner(tmp_path / "bag/train") as scanner:
        frame = scanner.trigger()
        with pytest.raises(ScannerError, match="no pose of the camera: use that of your hand-eye"):
            scanner.T_world_cam  # noqa: B018
    assert (
        frame.reason is frame.gray is None
        and frame.rgb is not None
        and np.isfinite(frame.depth_m).any()
    )
