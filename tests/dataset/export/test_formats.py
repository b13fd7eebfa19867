"""Every format is read by another program, and compared with the simulation."""

import contextlib
import gc
import io
import json
import struct
import tarfile
import warnings

import cv2
import numpy as np
import pictured
import pytest
import trimesh
import yaml
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from simulated_dataset import SCALE_MM, visible

from graycast.base.frames import inverse, pixel_grid
from graycast.dataset.export import Options, Split, export
from graycast.rig.optics import rays

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def poses_of(sample):
    return inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part


def decoded(data):
    """Return pixels read by Pillow."""
    with Image.open(io.BytesIO(data)) as image:
        return np.array(image)


def steps_of(depth_m):
    return np.rint(np.nan_to_num(depth_m) * 1e3 / SCALE_MM)


@pytest.mark.parametrize("polygons", [False, True])
def test_pycocotools_reads_masks_boxes_and_poses_of_a_coco_export(exported, samples, polygons):
    out = exported("coco", polygons=polygons, depth="both")
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(out / "annotations" / "instances_train.json"))
    assert coco.getImgIds() == list(samples)
    assert [c["name"] for c in coco.loadCats(coco.getCatIds())] == ["box", "wedge"]
    for image in coco.loadImgs(coco.getImgIds()):
        sample = samples[image["id"]]
        name = f"train/{image['file_name']}"
        assert np.array_equal(np.array(Image.open(out / "images" / name)), sample.rgb)
        for folder, depth_m in (
            ("depth", sample.truth.depth_m),
            ("depth_sl", sample.scanner_depth.depth_m),
        ):
            depth_steps = np.array(Image.open(out / folder / name))
            assert np.array_equal(depth_steps, steps_of(depth_m))
        instances, masks, boxes = visible(sample)
        anns = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        assert [ann["gt_id"] for ann in anns] == instances
        for i, mask, box, ann in zip(instances, masks, boxes, anns, strict=True):
            assert np.array_equal(coco.annToMask(ann), mask)
            assert ann["bbox"] == box
            assert ann["area"] == mask.sum()
            assert ann["category_id"] == sample.layout.part_index[i] + 1
            T = poses_of(sample)[i]
            np.testing.assert_allclose(np.reshape(ann["cam_R_m2c"], (3, 3)), T[:3, :3])
            np.testing.assert_allclose(ann["cam_t_m2c"], T[:3, 3] * 1e3)


@pytest.mark.parametrize("labels", ["boxes", "segments"])
def test_yolo_rows_contain_boxes_or_masks_in_relative_coordinates(exported, samples, labels):
    out = exported("yolo", labels=labels, split=Split(shares=(0.5, 0.5, 0.0)))
    data = yaml.safe_load((out / "data.yaml").read_text())
    assert data["names"] == {0: "box", 1: "wedge"}
    scene_ids = []
    for split in ("train", "val"):
        for picture in sorted((out / data[split]).glob("*.png")):
            sample = samples[int(picture.stem)]
            scene_ids.append(int(picture.stem))
            assert np.array_equal(np.array(Image.open(picture)), sample.rgb)
            # Ultralytics finds labels by this replacement of the last "images" of the path.
            text = (out / "labels" / split / f"{picture.stem}.txt").read_text()
            rows = [line.split() for line in text.splitlines()]
            instances, masks, boxes = visible(sample)
            assert [int(row[0]) for row in rows] == [sample.layout.part_index[i] for i in instances]
            height_px, width_px = masks[0].shape
            for row, mask, box in zip(rows, masks, boxes, strict=True):
                xy = np.array(row[1:], float).reshape(-1, 2) * [width_px, height_px]
                if labels == "boxes":
                    np.testing.assert_allclose(xy[0] - xy[1] / 2, box[:2], atol=1e-4)
                    np.testing.assert_allclose(xy[1], box[2:], atol=1e-4)
                    continue
                runs = coco_mask.frPyObjects([np.rint(xy).ravel().tolist()], height_px, width_px)
                assert np.array_equal(coco_mask.decode(coco_mask.merge(runs)), mask)
    assert sorted(scene_ids) == list(samples)


def test_globox_reads_yolo_boxes(exported, samples):
    globox = pytest.importorskip("globox", reason="pip install globox")
    out = exported("yolo", labels="boxes")
    read = globox.AnnotationSet.from_yolo_v5(
        out / "labels" / "train", image_folder=out / "images" / "train", image_extension=".png"
    )
    assert {one.image_id for one in read} == {f"{i:06d}.png" for i in samples}
    for scene_id, sample in samples.items():
        instances, _, boxes = visible(sample)
        read_boxes = read[f"{scene_id:06d}.png"].boxes
        assert [int(b.label) for b in read_boxes] == [
            sample.layout.part_index[i] for i in instances
        ]
        edges = [[b.xmin, b.ymin, b.xmax - b.xmin, b.ymax - b.ymin] for b in read_boxes]
        np.testing.assert_allclose(edges, boxes, atol=1e-3)


def bop_toolkit_mask(runs):
    """Return a mask of bop_toolkit's uncompressed run lengths by column, read by pycocotools."""
    return coco_mask.decode(coco_mask.frPyObjects(runs, *runs["size"])) == 1


def read_by_webdataset(folder):
    """Return all samples; the package leaves closing its files to the garbage collector."""
    webdataset = pytest.importorskip("webdataset", reason="pip install webdataset")
    urls = [str(path) for path in sorted(folder.glob("shard-*.tar"))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        data = webdataset.WebDataset(urls, shardshuffle=False)
        items = list(data)
        del data
        gc.collect()
    return items


def check_bop(files, sample, depth_m, info_key):
    camera = json.loads(files["camera.json"])
    assert np.array_equal(decoded(files["rgb.png"]), sample.rgb)
    depth_mm = decoded(files["depth.png"]) * camera["depth_scale"]
    np.testing.assert_allclose(depth_mm, steps_of(depth_m) * SCALE_MM)
    gt, info = json.loads(files["gt.json"]), json.loads(files["gt_info.json"])
    visib, whole = json.loads(files["mask_visib.json"]), json.loads(files["mask.json"])
    assert len(gt) == len(info) == len(visib) == len(whole) == 8
    for i, T in enumerate(poses_of(sample)):
        np.testing.assert_allclose(np.reshape(gt[i]["cam_R_m2c"], (3, 3)), T[:3, :3])
        np.testing.assert_allclose(gt[i]["cam_t_m2c"], T[:3, 3] * 1e3)
        assert np.array_equal(bop_toolkit_mask(visib[str(i)]), sample.truth.instance == i)
        amodal = sample.truth.amodal[i].in_image(*sample.rgb.shape[:2])
        assert np.array_equal(bop_toolkit_mask(whole[str(i)]), amodal)
        valid = amodal & (steps_of(depth_m) > 0)
        assert info[i]["px_count_valid"] == valid.sum(), info_key


@pytest.mark.slow
@pytest.mark.parametrize("depth", ["perfect", "scanner"])
def test_the_webdataset_package_reads_bop_shards(exported, samples, depth):
    out = exported("bop-webdataset", shard_scenes=3, depth=depth)
    shard_of = json.loads((out / "train" / "key_to_shard.json").read_text())
    assert shard_of == {f"{i:06d}_000000": n // 3 for n, i in enumerate(samples)}
    items = read_by_webdataset(out / "train")
    for item, sample in zip(items, samples.values(), strict=True):
        depth_m = sample.truth.depth_m if depth == "perfect" else sample.scanner_depth.depth_m
        check_bop(item, sample, depth_m, item["__key__"])
        assert shard_of[item["__key__"]] == int(item["__url__"][-10:-4])
    assert json.loads((out / "models" / "models_info.json").read_text()).keys() == {"1", "2"}


def test_equal_datasets_give_equal_shards_without_names_or_times(exported):
    shards = [exported("bop-webdataset") / "train" / "shard-000000.tar" for _ in range(2)]
    assert shards[0].read_bytes() == shards[1].read_bytes()
    with tarfile.open(shards[0]) as shard:
        assert {(m.mtime, m.uid, m.uname) for m in shard.getmembers()} == {(0, 0, "")}


@pytest.mark.slow
def test_pyarrow_reads_a_parquet_export(exported, samples):
    pq = pytest.importorskip("pyarrow.parquet", reason="pip install 'graycast[parquet]'")
    out = exported("parquet", shard_scenes=3, image="gray")
    parts = sorted((out / "train").glob("*.parquet"))
    assert [pq.read_metadata(part).num_rows for part in parts] == [3, 1]
    rows = [row for part in parts for row in pq.read_table(part).to_pylist()]
    for row, (scene_id, sample) in zip(rows, samples.items(), strict=True):
        instances, masks, boxes = visible(sample)
        assert row["scene_id"] == scene_id
        assert row["rgb"] is None
        assert np.array_equal(decoded(row["gray"]["bytes"]), sample.gray)
        assert np.array_equal(
            decoded(row["depth_sl"]["bytes"]), steps_of(sample.scanner_depth.depth_m)
        )
        assert row["boxes"] == boxes
        poses = np.reshape(row["poses"], (-1, 4, 4))
        np.testing.assert_allclose(poses, poses_of(sample)[instances], atol=1e-12)
        for runs, mask in zip(row["masks"], masks, strict=True):
            assert np.array_equal(coco_mask.decode(runs), mask)


def expected_points(sample, depth_m):
    camera = sample.scene.rig.camera
    stored_m = steps_of(depth_m) * SCALE_MM / 1e3
    stored_m[stored_m == 0] = np.nan
    return rays(camera, pixel_grid(camera.height_px, camera.width_px)) * stored_m[..., None]


@pytest.mark.parametrize("organised", [False, True])
def test_trimesh_reads_ply_clouds(exported, samples, organised):
    out = exported("clouds", organised=organised)
    for scene_id, sample in samples.items():
        for name, depth_m in (
            ("perfect", sample.truth.depth_m),
            ("scanner", sample.scanner_depth.depth_m),
        ):
            cloud = trimesh.load(out / "train" / f"{scene_id:06d}_{name}.ply")
            point_m = expected_points(sample, depth_m)
            known = np.ones(point_m.shape[:2], bool) if organised else ~np.isnan(point_m[..., 2])
            np.testing.assert_allclose(cloud.vertices, point_m[known], atol=1e-6)
            assert np.array_equal(cloud.colors[:, :3], sample.rgb[known])


@pytest.mark.parametrize("organised", [False, True])
def test_pcd_clouds_follow_the_format(exported, samples, organised):
    out = exported("clouds", cloud="pcd", organised=organised, depth="scanner", image="gray")
    sample = samples[3]
    data = (out / "train" / "000003_scanner.pcd").read_bytes()
    head, body = data.split(b"DATA binary\n", 1)
    header = dict(line.split(" ", 1) for line in head.decode().splitlines()[1:])
    count = int(header["POINTS"])
    assert int(header["WIDTH"]) * int(header["HEIGHT"]) == count
    assert (int(header["HEIGHT"]) == 120) == organised
    assert header["FIELDS"] == "x y z rgb"
    values = np.array(list(struct.iter_unpack("<fffI", body)))
    point_m = expected_points(sample, sample.scanner_depth.depth_m)
    known = np.ones(point_m.shape[:2], bool) if organised else ~np.isnan(point_m[..., 2])
    np.testing.assert_allclose(values[:, :3], point_m[known], atol=1e-6)
    gray = sample.gray[known].astype(int)
    assert np.array_equal(values[:, 3], gray * 0x010101)


@pytest.mark.parametrize("organised", [False, True])
def test_pcd_clouds_are_read_by_pypcd4(exported, samples, organised):
    pypcd4 = pytest.importorskip("pypcd4", reason="pip install pypcd4")
    out = exported("clouds", cloud="pcd", organised=organised)
    for scene_id, sample in samples.items():
        for name, depth_m in (
            ("perfect", sample.truth.depth_m),
            ("scanner", sample.scanner_depth.depth_m),
        ):
            cloud = pypcd4.PointCloud.from_path(out / "train" / f"{scene_id:06d}_{name}.pcd")
            point_m = expected_points(sample, depth_m)
            known = np.ones(point_m.shape[:2], bool) if organised else ~np.isnan(point_m[..., 2])
            np.testing.assert_allclose(cloud.numpy(("x", "y", "z")), point_m[known], atol=1e-6)
            color = pypcd4.PointCloud.decode_rgb(cloud.numpy(("rgb",)))
            assert np.array_equal(color.reshape(-1, 3), sample.rgb[known])


def test_cloud_points_of_a_distorted_lens_are_on_the_true_rays(tmp_path):
    """Oracle: OpenCV's undistortion of the pixels, with the rig's coefficients."""
    samples = pictured.write_dataset(tmp_path / "out", (0,), pictured.lensed_rig())
    options = Options(format="clouds", split=Split(), organised=True, depth="perfect")
    export(tmp_path / "out", tmp_path / "clouds", options)
    cloud = trimesh.load(tmp_path / "clouds/train/000000_perfect.ply")
    camera = samples[0].scene.rig.camera
    y, x = np.mgrid[0:120, 0:160].astype(float)
    pixel = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    slope = cv2.undistortPoints(pixel, camera.K, np.array(camera.distortion))[:, 0]
    assert np.abs(slope * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2] - pixel[:, 0]).max() > 2
    z_m = cloud.vertices[:, 2]
    known = z_m > 0
    error_m = np.abs(cloud.vertices[:, :2] - slope * z_m[:, None])[known]
    assert known.mean() > 0.9 and error_m.max() < 1e-5  # a pixel is 2.4e-3


def test_an_organised_cloud_gives_depth_and_camera_back(exported, samples):
    """Oracle: the reader of real clouds, which fits the camera to the points."""
    from graycast.real.realism import read_scans

    out = exported("clouds", organised=True, depth="scanner")
    (scan,) = read_scans([out / "train" / "000003_scanner.ply"])
    camera = samples[3].scene.rig.camera
    np.testing.assert_allclose(scan.K, camera.K, atol=1e-3)
    np.testing.assert_allclose(
        scan.depth_m, samples[3].scanner_depth.depth_m, atol=0.6e-3 * SCALE_MM
    )


def test_parquet_declares_which_columns_are_pictures(exported):
    """Hugging Face reads a struct of bytes and path as an Image if the metadata says so."""
    pq = pytest.importorskip("pyarrow.parquet", reason="pip install 'graycast[parquet]'")
    schema = pq.read_schema(exported("parquet") / "train" / "part-000000.parquet")
    features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert features == {name: {"_type": "Image"} for name in ("rgb", "gray", "depth", "depth_sl")}
    for name in features:
        fields = {field.name: str(field.type) for field in schema.field(name).type}
        assert fields == {"bytes": "binary", "path": "string"}


def test_hugging_face_loads_pictures_from_a_parquet_export(exported, samples, tmp_path):
    datasets = pytest.importorskip("datasets", reason="pip install datasets")
    out = exported("parquet")
    files = [str(path) for path in sorted((out / "train").glob("*.parquet"))]
    read = datasets.load_dataset(
        "parquet", data_files={"train": files}, cache_dir=str(tmp_path / "cache")
    )["train"]
    assert isinstance(read.features["rgb"], datasets.Image)
    for row, sample in zip(read, samples.values(), strict=True):
        assert np.array_equal(np.array(row["rgb"]), sample.rgb)
        assert np.array_equal(np.array(row["depth_sl"]), steps_of(sample.scanner_depth.depth_m))
        assert row["gray"] is None


def toolkit_mask(vertices_mm, faces, K, width_px, height_px):
    """Return the pixels that bop_toolkit's OpenGL renderers cover for a mesh in the camera frame.

    Their matrix has the rows (2 fx/w, 0, (w - 2 cx)/w, 0), (0, 2 fy/h, (2 cy - h)/h, 0) and
    (0, 0, -1, 0) for x, y and the divisor, of points with negated y and z. OpenGL maps -1 to 1 to
    the window's edges and samples at pixel centres.
    """
    x, y, z = (vertices_mm * [1, -1, -1]).T
    clip_x = 2 * K[0, 0] / width_px * x + (width_px - 2 * K[0, 2]) / width_px * z
    clip_y = 2 * K[1, 1] / height_px * y + (2 * K[1, 2] - height_px) / height_px * z
    window = np.stack([(clip_x / -z + 1) / 2 * width_px, (1 - clip_y / -z) / 2 * height_px], axis=1)
    row, column = np.mgrid[:height_px, :width_px] + 0.5
    covered = np.zeros((height_px, width_px), dtype=bool)
    for a, b, c in window[faces]:
        sides = [
            (q[0] - p[0]) * (row - p[1]) - (q[1] - p[1]) * (column - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        covered |= np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)
    return covered


def test_bop_toolkit_renders_our_masks_if_the_origin_is_a_pixel_corner(exported, samples):
    """Oracle: their projection, rasterised here; with BOP's origin, pixels at the rim differ."""
    sample, overlap = samples[0], {}
    for origin in ("centre", "corner"):
        out = exported("bop-webdataset", pixel_origin=origin)
        with tarfile.open(out / "train/shard-000000.tar") as shard:
            view = json.load(shard.extractfile("000000_000000.camera.json"))
        K = np.reshape(view["cam_K"], (3, 3))
        whole = json.loads((out / "camera.json").read_text())
        assert [whole["cx"], whole["cy"]] == K[:2, 2].tolist()
        met = joined = 0
        for i in (0, 1, 2, 3, 5):  # inside the image
            T, part = poses_of(sample)[i], sample.scene.parts[sample.layout.part_index[i]]
            vertices_mm = 1e3 * (part.mesh.vertices_m @ T[:3, :3].T + T[:3, 3])
            theirs = toolkit_mask(vertices_mm, part.mesh.faces, K, 160, 120)
            own = sample.truth.amodal[i].in_image(120, 160)
            met, joined = met + (theirs & own).sum(), joined + (theirs | own).sum()
        overlap[origin] = met / joined
    assert overlap["corner"] > 0.9995
    assert overlap["centre"] < 0.97


def test_our_own_reader_puts_the_origin_at_a_pixel_centre_for_every_export(exported, samples):
    from graycast.dataset.training import open_examples

    example = open_examples(exported("bop-webdataset", pixel_origin="corner"))[0]
    np.testing.assert_allclose(example.K, samples[0].scene.rig.camera.K)
