"""Bags are read by Foxglove's decoder, which shares no code with their writer."""

import shutil
import sqlite3
from collections import defaultdict

import cv2
import numpy as np
import pictured
import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from several_pictures import NAMES, SCENES, several  # noqa: F401
from simulated_dataset import SCALE_MM

from graycast.base.frames import inverse, pixel_grid, rotation_from_quaternion
from graycast.dataset.export import Options, export
from graycast.rig.optics import rays

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
FIRST_NS, SECOND_NS = 946_684_800 * 10**9, 10**9
BAGS = ("ros2bag", "mcap")


def read_mcap(bag):
    with open(bag / f"{bag.name}.mcap", "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


def read_sqlite(bag):
    """Yield messages in the order in which `ros2 bag play` selects them."""
    database, factory = sqlite3.connect(bag / f"{bag.name}.db3"), DecoderFactory()
    definitions = database.execute(
        "SELECT id, topic_type, encoding, encoded_message_definition FROM message_definitions"
    )
    decoder = {
        name: factory.decoder_for(
            "cdr", Schema(id=key, name=name, encoding=encoding, data=text.encode())
        )
        for key, name, encoding, text in definitions
    }
    for topic, name, time_ns, data in database.execute(
        "SELECT topics.name, type, timestamp, data FROM messages "
        "JOIN topics ON topics.id = topic_id ORDER BY timestamp, messages.id"
    ):
        yield topic, time_ns, decoder[name](data)
    database.close()


def messages(bag):
    """Return the messages of each topic with their times."""
    read = read_mcap if (bag / f"{bag.name}.mcap").exists() else read_sqlite
    by_topic = defaultdict(list)
    for topic, time_ns, message in read(bag):
        by_topic[topic].append((time_ns, message))
    return by_topic


@pytest.fixture(scope="module", params=BAGS)
def bag(request, master, tmp_path_factory):
    """Return the folder of a bag of the whole dataset, in each of the two storages."""
    out = tmp_path_factory.mktemp("bag") / request.param
    export(master, out, Options(format=request.param))
    return out / "train"


@pytest.fixture(scope="module")
def topics(bag):
    return messages(bag)


def pixels(image):
    """Return the pixels of an image message, by the definitions of its encodings."""
    dtype, channels = {
        "rgb8": ("u1", 3), "mono8": ("u1", 1), "32FC1": ("<f4", 1), "16UC1": ("<u2", 1),
    }[image.encoding]  # fmt: skip
    assert image.step == image.width * channels * np.dtype(dtype).itemsize
    assert not image.is_bigendian
    array = np.frombuffer(bytes(image.data), dtype).reshape(image.height, image.width, channels)
    return array if channels > 1 else array[..., 0]


def fields(cloud):
    """Return the fields of an organised cloud by name; 7 is FLOAT32 in sensor_msgs/PointField."""
    assert [f.datatype for f in cloud.fields] == [7] * len(cloud.fields)
    assert cloud.row_step == cloud.width * cloud.point_step and not cloud.is_dense
    kind = np.dtype(
        {
            "names": [f.name for f in cloud.fields],
            "formats": ["<f4"] * len(cloud.fields),
            "offsets": [f.offset for f in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    return np.frombuffer(bytes(cloud.data), kind).reshape(cloud.height, cloud.width)


def xyz(cloud):
    return np.stack([fields(cloud)[axis] for axis in "xyz"], axis=-1)


def matrix(position, turn):
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))
    T[:3, 3] = position.x, position.y, position.z
    return T


def stored_m(depth_m):
    steps = np.rint(np.nan_to_num(depth_m) * 1e3 / SCALE_MM)
    return np.where(steps > 0, steps * SCALE_MM / 1e3, np.nan)


def test_pictures_depth_and_points_of_a_bag_are_those_of_the_scanner(topics, samples):
    for k, sample in enumerate(samples.values()):
        depth_m, camera = stored_m(sample.scanner_depth.depth_m), sample.scene.rig.camera
        ray = rays(camera, pixel_grid(camera.height_px, camera.width_px))
        expected = {
            "/scanner/color/image_raw": sample.rgb,
            "/scanner/depth/image_raw": depth_m.astype(np.float32),
            "/truth/scanner/depth/image_raw": stored_m(sample.truth.depth_m).astype(np.float32),
            "/truth/scanner/instances": sample.truth.instance + 1,
        }
        for topic, image in expected.items():
            np.testing.assert_array_equal(pixels(topics[topic][k][1]), image, topic)
        cloud = topics["/scanner/points"][k][1]
        np.testing.assert_allclose(xyz(cloud), ray * depth_m[..., None], atol=1e-6)
        assert np.isnan(xyz(cloud)).any()
        color = fields(cloud)["rgb"].copy().view("<u4")
        red, green, blue = np.moveaxis(sample.rgb.astype(int), -1, 0)
        assert np.array_equal(color, red * 65536 + green * 256 + blue)
        for kind in ("color", "depth"):
            info = topics[f"/scanner/{kind}/camera_info"][k][1]
            assert np.array_equal(np.reshape(info.k, (3, 3)), camera.K)
            assert np.array_equal(np.reshape(info.p, (3, 4)), camera.K @ np.eye(3, 4))
            assert (info.width, info.height) == (camera.width_px, camera.height_px)
            assert info.distortion_model == "plumb_bob" and not any(info.d)


def test_frames_and_true_poses_of_a_bag_are_those_of_the_simulation(topics, samples):
    for k, sample in enumerate(samples.values()):
        (transform,) = topics["/tf_static"][k][1].transforms
        assert transform.header.frame_id == "world"
        assert transform.child_frame_id == "scanner_optical_frame"
        T_world_cam = matrix(transform.transform.translation, transform.transform.rotation)
        np.testing.assert_allclose(T_world_cam, sample.scene.T_world_cam, atol=1e-9)
        poses = topics["/truth/scanner/poses"][k][1]
        assert poses.header.frame_id == "scanner_optical_frame"
        T_cam_part = np.stack([matrix(pose.position, pose.orientation) for pose in poses.poses])
        expected = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part
        np.testing.assert_allclose(T_cam_part, expected, atol=1e-9)
        obj_ids = topics["/truth/scanner/obj_ids"][k][1].data
        assert list(obj_ids) == [index + 1 for index in sample.layout.part_index]


@pytest.mark.slow
def test_points_of_a_bag_project_to_their_pixels_through_its_camera_info(tmp_path):
    """Oracle: OpenCV's projection, with the intrinsics and distortion of the messages."""
    pictured.write_dataset(tmp_path / "out", (0,), pictured.lensed_rig())
    export(tmp_path / "out", tmp_path / "bag", Options(format="mcap", depth="perfect"))
    topics = messages(tmp_path / "bag" / "train")
    info, point_m = (
        topics["/scanner/depth/camera_info"][0][1],
        xyz(topics["/scanner/points"][0][1]),
    )
    known = np.isfinite(point_m[..., 2])
    assert any(info.d) and known.mean() > 0.9 and point_m[known][:, 2].min() > 0.1
    K, lens = np.reshape(info.k, (3, 3)), np.array(info.d)
    pixel = cv2.projectPoints(point_m[known].astype(float), np.zeros(3), np.zeros(3), K, lens)[0]
    assert np.abs(pixel[:, 0] - pixel_grid(*known.shape)[known]).max() < 1e-2
    assert not any(topic.startswith("/truth/scanner/depth") for topic in topics)


def test_the_metadata_of_a_bag_lists_its_messages_and_how_they_are_sent(bag, topics):
    info = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    (name,) = info["relative_file_paths"]
    ending = {"sqlite3": ".db3", "mcap": ".mcap"}[info["storage_identifier"]]
    assert (bag / name).is_file() and name.endswith(ending)
    counts = {
        t["topic_metadata"]["name"]: t["message_count"] for t in info["topics_with_message_count"]
    }
    assert counts == {topic: len(each) for topic, each in topics.items()}
    assert info["message_count"] == sum(counts.values())
    for topic in info["topics_with_message_count"]:
        (quality,) = yaml.safe_load(topic["topic_metadata"]["offered_qos_profiles"])
        latched = topic["topic_metadata"]["name"] == "/tf_static"
        assert quality["reliability"] == 1  # reliable
        assert quality["durability"] == (1 if latched else 2)  # transient local, or volatile


def test_the_times_of_a_bag_are_whole_seconds_in_the_order_of_the_pictures(topics, samples):
    for topic, each in topics.items():
        early_ns = SECOND_NS // 2 if topic == "/tf_static" else 0
        times = [FIRST_NS + k * SECOND_NS - early_ns for k in range(len(samples))]
        assert [time_ns for time_ns, _ in each] == times, topic
        if hasattr(each[0][1], "header"):
            stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for _, m in each]
            assert stamps == [(time_ns // SECOND_NS, 0) for time_ns in times]


def test_equal_datasets_give_equal_bags(exported, bag):
    bags = [bag, exported(bag.parent.name) / "train"]
    names = sorted(path.name for path in bags[0].iterdir())
    assert len(names) == 2
    for name in names:
        assert (bags[0] / name).read_bytes() == (bags[1] / name).read_bytes(), name


@pytest.mark.slow
def test_the_points_of_a_bag_have_the_probability_that_their_depth_is_wrong(
    master, samples, tmp_path
):
    """Law of the stored steps: 255 is 1, and 254 steps lower is 1e-4."""
    dataset = shutil.copytree(master, tmp_path / "dataset")
    step = np.random.default_rng(0).integers(0, 256, samples[0].gray.shape, dtype=np.uint8)
    for scene_id in samples:
        folder = dataset / "train" / f"{scene_id:06d}" / "pwrong_sl"
        folder.mkdir()
        cv2.imwrite(str(folder / "000000.png"), step)
    export(dataset, tmp_path / "bag", Options(format="mcap"))
    cloud = messages(tmp_path / "bag" / "train")["/scanner/points"][0][1]
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "rgb", "p_wrong"]
    p_wrong = np.where(step > 0, 1e-4 ** ((255.0 - step) / 254), np.nan)
    np.testing.assert_allclose(fields(cloud)["p_wrong"], p_wrong, rtol=1e-5)


@pytest.mark.slow
def test_each_scanner_of_a_bag_has_topics_and_its_pose_precedes_each_picture(several, tmp_path):  # noqa: F811
    out, samples = several
    export(out, tmp_path / "bag", Options(format="mcap"))
    topics, poses, place = messages(tmp_path / "bag" / "train"), {}, 0
    assert {topic.split("/")[-2] for topic in topics if topic.endswith("/points")} == {
        "left", "right",
    }  # fmt: skip
    events = sorted(
        ((time_ns, topic, m) for topic in topics for time_ns, m in topics[topic]),
        key=lambda event: event[:2],
    )
    for time_ns, topic, message in events:
        if topic == "/tf_static":
            (one,) = message.transforms
            poses[one.child_frame_id] = matrix(one.transform.translation, one.transform.rotation)
        elif topic.endswith("/points"):
            sample = samples[SCENES[place // len(NAMES)]][place % len(NAMES)]
            assert time_ns == FIRST_NS + place * SECOND_NS
            assert message.header.frame_id == f"{sample.sensor}_optical_frame"
            np.testing.assert_allclose(
                poses[message.header.frame_id], sample.scene.T_world_cam, atol=1e-9
            )
            assert (message.height, message.width) == sample.gray.shape
            place += 1
    assert place == len(SCENES) * len(NAMES)


@pytest.mark.slow
def test_a_bag_of_real_pictures_has_no_poses(tmp_path):
    pictured.write_dataset(tmp_path / "out", (0,))
    pictured.forget(tmp_path / "out")
    export(tmp_path / "out", tmp_path / "bag", Options(format="ros2bag"))
    assert sorted(messages(tmp_path / "bag" / "train")) == [
        "/scanner/color/camera_info",
        "/scanner/color/image_raw",
        "/scanner/depth/camera_info",
        "/scanner/depth/image_raw",
        "/scanner/points",
        "/truth/scanner/instances",
        "/truth/scanner/obj_ids",
    ]


@pytest.mark.slow
def test_rosbags_reads_its_own_bag_with_the_white_frame(exported, samples):
    from rosbags.highlevel import AnyReader

    out = exported("ros2bag", image="gray", depth="none")
    with AnyReader([out / "train"]) as reader:
        topics = {connection.topic for connection in reader.connections}
        pictures = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.topic == "/scanner/color/image_raw"
        ]
    assert not any("points" in topic or "depth" in topic for topic in topics)
    for picture, sample in zip(pictures, samples.values(), strict=True):
        assert picture.encoding == "mono8"
        assert np.array_equal(picture.data.reshape(sample.gray.shape), sample.gray)
