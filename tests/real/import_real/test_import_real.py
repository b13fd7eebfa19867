"""Import of real pictures, tested with the pictures of a simulated dataset."""

import json
import re
import shutil

import cv2
import numpy as np
import pytest
from backends import slow
from PIL import Image
from simulated_dataset import SCALE_MM, require_library, visible, write_dataset

from graycast.base.errors import DatasetError, GraycastError
from graycast.cli import main
from graycast.dataset.check.checking import validate
from graycast.dataset.export import FORMATS, Options, export
from graycast.dataset.read.real import absent
from graycast.dataset.training import open_examples
from graycast.real.depth_file import FileOptions
from graycast.real.import_real import import_real
from graycast.real.realism import read_scans

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SCENES = (0, 3)
SCALE_M = SCALE_MM / 1e3


@pytest.fixture(scope="session")
def simulation(tmp_path_factory):
    """Return a folder with a simulated dataset and its scanner's pictures, and the samples."""
    folder = tmp_path_factory.mktemp("made")
    samples = write_dataset(folder / "master", SCENES)
    export(folder / "master", folder / "coco", Options(format="coco", polygons=True))
    real = folder / "real"
    for name in ("rgb", "gray", "depth"):
        (real / name).mkdir(parents=True)
    for scene_id, sample in samples.items():
        scene, stem = folder / "master" / "train" / f"{scene_id:06d}", f"{scene_id:06d}"
        shutil.copy(scene / "rgb/000000.png", real / "rgb" / f"{stem}.png")
        cv2.imwrite(str(real / "gray" / f"{stem}.tiff"), sample.gray)
        shutil.copy(scene / "depth_sl/000000.png", real / "depth" / f"{stem}.png")
    (real / "annotations").mkdir()
    shutil.copy(folder / "coco/annotations/instances_train.json", real / "annotations")
    return folder, samples


@pytest.fixture
def real(simulation, tmp_path):
    return shutil.copytree(simulation[0] / "real", tmp_path / "real")


@pytest.fixture
def samples(simulation):
    return simulation[1]


def K_of(samples):
    return samples[0].scene.rig.camera.K


def imported(real, samples, **options):
    out = real.parent / "out"
    of_files = {"K": K_of(samples), "scale_m": SCALE_M}
    of_files |= {
        key: options.pop(key) for key in FileOptions.__dataclass_fields__ if key in options
    }
    return out, import_real(real, out, files=FileOptions(**of_files), **options)


def refusal(real, samples, **options):
    with pytest.raises(GraycastError) as caught:
        imported(real, samples, **options)
    left = {path.name for path in real.parent.iterdir()}
    assert "out" not in left and not any(".part-" in name for name in left)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def labelme(real, samples, **changed):
    """Replace the COCO file with LabelMe files of rectangles around the visible parts."""
    shutil.rmtree(real / "annotations")
    (real / "annotations").mkdir()
    for scene_id, sample in samples.items():
        shapes = []
        for i, box in zip(visible(sample)[0], visible(sample)[2], strict=True):
            x, y, w, h = (float(edge) for edge in box)
            shapes.append(
                {
                    "label": ("box", "wedge")[sample.layout.part_index[i]],
                    "points": [[x, y], [x + w, y + h]],
                    "group_id": None,
                    "shape_type": "rectangle",
                }
            )
        content = {"shapes": shapes, "imageHeight": 120, "imageWidth": 160} | changed
        path = real / "annotations" / f"{scene_id:06d}.json"
        path.write_text(json.dumps(content))


def test_a_simulated_scan_imported_as_real_gives_the_same_examples(simulation, real, samples):
    """Pictures, masks, boxes and scanner depth are exactly equal; unknown values are missing."""
    out, done = imported(real, samples)
    assert done.categories == ("box", "wedge")
    assert done.holds == ("rgb", "gray_sl", "depth_sl", "masks")
    assert done.depth_scale_mm == SCALE_MM
    simulated = open_examples(simulation[0] / "master")
    for a, b in zip(simulated, open_examples(out), strict=True):
        for name in ("rgb", "gray", "scanner_depth_m", "mask", "box_px", "obj_id", "K"):
            np.testing.assert_array_equal(getattr(b, name), getattr(a, name), err_msg=name)
        assert b.depth_m is b.T_cam_part is b.visib_fract is None


def test_validate_accepts_the_import_and_lists_missing_data(real, samples):
    out, _ = imported(real, samples)
    assert validate(out) == ()
    assert absent(out)[:3] == ("poses", "models", "perfect depth")
    (view,) = {
        tuple(json.loads((out / f"train/00000{i}/scene_camera.json").read_text())["0"])
        for i in (0, 1)
    }
    assert set(view) == {"cam_K", "depth_scale"}


def flip(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


DAMAGE = {
    "a truncated picture": (
        lambda s: (s / "rgb/000000.png").write_bytes((s / "rgb/000000.png").read_bytes()[:99]),
        "rgb/000000.png is cut off",
    ),
    "a lost depth picture": (
        lambda s: (s / "depth_sl/000000.png").unlink(), "depth_sl/000000.png is missing"
    ),
    "a lost mask": (
        lambda s: (s / "mask_visib/000000_000001.png").unlink(), "instances, . masks"
    ),
    "another mask": (
        lambda s: shutil.copy(
            s / "mask_visib/000000_000001.png", s / "mask_visib/000000_000000.png"
        ),
        "segmentation is not the mask_visib",
    ),
    "another object": (
        lambda s: flip(s / "scene_gt.json", lambda c: c["0"][0].update(obj_id=9)),
        "instance 0 is of object 9",
    ),
    "a moved box": (
        lambda s: flip(
            s / "scene_gt_info.json", lambda c: c["0"][0].update(bbox_visib=[0, 0, 1, 1])
        ),
        "instance 0: its boxes",
    ),
    "another scale": (
        lambda s: flip(s / "scene_camera.json", lambda c: c["0"].update(depth_scale=1.0)),
        "depth_scale is not",
    ),
    "other annotations of the set": (
        lambda s: flip(
            s.parents[1] / "train_coco.json", lambda c: c["annotations"][0].update(area=1)
        ),
        "annotations of image 0 are not",
    ),
    "half a camera": (lambda s: (s.parents[1] / "camera.json").write_text("{"), "camera.json"),
    "another scale of the camera": (
        lambda s: flip(s.parents[1] / "camera.json", lambda c: c.update(depth_scale=1.0)),
        "camera.json: depth_scale is not",
    ),
    "no scene": (lambda s: [shutil.rmtree(p) for p in s.parent.iterdir()], "holds no scene"),
    "a picture of another size": (
        lambda s: cv2.imwrite(str(s / "rgb/000000.png"), np.zeros((9, 7, 3), np.uint8)),
        r"rgb/000000.png is \(9, 7, 3\) uint8, it must be",
    ),
    "an empty mask": (
        lambda s: cv2.imwrite(
            str(s / "mask_visib/000000_000001.png"), np.zeros((120, 160), np.uint8)
        ),
        "000000_000001.png is empty",
    ),
    "no list of the set": (
        lambda s: (s.parents[1] / "train_coco.json").unlink(), "train_coco.json is missing"
    ),
    "another category of the set": (
        lambda s: flip(
            s.parents[1] / "train_coco.json", lambda c: c["categories"][0].update(name="lid")
        ),
        "categories are not the parts",
    ),
    "an image less in the set": (
        lambda s: flip(s.parents[1] / "train_coco.json", lambda c: c["images"].pop()),
        "images are not the scenes",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", [n if k % 4 == 0 else slow(n) for k, n in enumerate(DAMAGE)])
def test_validate_detects_damage_of_the_import(real, samples, name):
    out, _ = imported(real, samples)
    damage, what = DAMAGE[name]
    damage(out / "train" / "000000")
    problems = [str(problem) for problem in validate(out)]
    assert any(re.search(what, problem) for problem in problems), problems


@pytest.mark.slow
def test_all_readers_of_datasets_accept_an_import(real, samples):
    """The readers are those of `real measure` and of each export that the data suffice for."""
    out, _ = imported(real, samples)
    scans = list(read_scans([out]))
    for scan, sample in zip(scans, samples.values(), strict=True):
        np.testing.assert_allclose(scan.depth_m, sample.scanner_depth.depth_m, atol=0.51 * SCALE_M)
        np.testing.assert_allclose(scan.gray, sample.gray / 255)
    with pytest.raises(GraycastError, match="has no perfect depth; it holds depth_sl, gray_sl"):
        export(out, real.parent / "no", Options(format="parquet", depth="perfect"))


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
def test_an_import_is_exported_to_every_format(real, samples, form):
    require_library(form)
    out, _ = imported(real, samples)
    export(out, real.parent / form, Options(format=form))
    if FORMATS[form].reader is not None:
        again = open_examples(real.parent / form)
        for a, b in zip(open_examples(out), again, strict=True):
            np.testing.assert_array_equal(a.mask, b.mask)
            np.testing.assert_array_equal(a.rgb, b.rgb)
            assert b.T_cam_part is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["npy", "tiff", "png", "ply"])
def test_depth_of_every_file_format_is_imported_within_half_a_step(simulation, real, samples, kind):
    for scene_id in samples:
        steps = cv2.imread(str(real / "depth" / f"{scene_id:06d}.png"), cv2.IMREAD_UNCHANGED)
        depth_m = np.where(steps > 0, steps * SCALE_M, np.nan)
        if kind == "npy":
            np.save(real / "depth" / f"{scene_id:06d}.npy", depth_m)
        elif kind == "tiff":
            image = depth_m.astype(np.float32)
            cv2.imwrite(str(real / "depth" / f"{scene_id:06d}.tiff"), image)
        if kind != "png":
            (real / "depth" / f"{scene_id:06d}.png").unlink()
    options = {"scale_m": SCALE_M if kind == "png" else None}
    if kind == "ply":
        export(
            simulation[0] / "master",
            real.parent / "clouds",
            Options(format="clouds", organised=True, depth="scanner"),
        )
        for path in sorted((real.parent / "clouds" / "train").glob("*.ply")):
            shutil.copy(path, real / "depth" / f"{path.stem[:6]}.ply")
        shutil.rmtree(real / "rgb")
        options["K"] = None  # K and colours come from the cloud.
    out, done = imported(real, samples, **options)
    for example, sample in zip(open_examples(out), samples.values(), strict=True):
        np.testing.assert_array_equal(example.rgb, sample.rgb)
        np.testing.assert_allclose(example.K, K_of(samples), atol=1e-3)
        step_m = done.depth_scale_mm / 1e3
        off_m = 0.5 * SCALE_M + 0.51 * step_m
        np.testing.assert_allclose(
            example.scanner_depth_m, sample.scanner_depth.depth_m, atol=off_m
        )
    assert done.depth_scale_mm == (SCALE_MM if kind == "png" else 0.02)
    assert validate(out) == ()


def test_labelme_rectangles_polygons_and_groups_become_masks(real, samples):
    labelme(real, samples)
    first = real / "annotations" / "000000.json"

    def change(content):
        shape = content["shapes"][0]
        (x0, y0), (x1, y1) = shape["points"]
        corner = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
        shape.update(points=corner, shape_type="polygon", group_id=5)
        content["shapes"].append(shape | {"points": [[0, 0], [3, 0], [3, 2], [0, 2]]})

    flip(first, change)
    out, done = imported(real, samples)
    assert done.categories == ("box", "wedge")
    example = open_examples(out)[0]
    for i, (x, y, w, h) in enumerate(visible(samples[0])[2]):
        mask = np.zeros((120, 160), dtype=bool)
        mask[y : y + h, x : x + w] = True
        if i == 0:
            mask[:2, :3] = True  # the other shape of the group
        np.testing.assert_array_equal(example.mask[i], mask)
    assert validate(out) == ()


def test_objects_get_the_numbers_of_a_named_dataset(real, samples):
    out, done = imported(real, samples, names=["lid", "wedge", "box"])
    assert done.categories == ("lid", "wedge", "box")
    ids = {0: 3, 1: 2}
    instances = visible(samples[0])[0]
    expected = [ids[samples[0].layout.part_index[i]] for i in instances]
    np.testing.assert_array_equal(open_examples(out)[0].obj_id, expected)
    shutil.rmtree(out)
    assert "name 'wedge'" in refusal(real, samples, names=["box"])


def test_pictures_without_labels_are_imported_on_request(real, samples):
    shutil.rmtree(real / "annotations")
    assert "or --unlabelled" in refusal(real, samples)
    out, _ = imported(real, samples, labelled=False)
    assert validate(out) == ()
    assert "masks" in absent(out)
    assert open_examples(out)[0].mask is None
    with pytest.raises(GraycastError, match="has no masks, which the format yolo needs"):
        export(out, real.parent / "yolo", Options(format="yolo"))
    export(out, real.parent / "clouds", Options(format="clouds"))


def test_broken_pictures_are_reported_by_name(real, samples):
    for name in ("rgb/000003.png", "gray/000003.tiff", "depth/000003.png"):
        path = real / name
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        assert str(path) in refusal(real, samples)
        path.write_bytes(data)
    Image.fromarray(np.zeros((120, 160, 3), np.uint8)).save(real / "rgb/000003.jpg")
    assert "another file has the same name" in refusal(real, samples)
    (real / "rgb/000003.png").unlink()
    data = (real / "rgb/000003.jpg").read_bytes()
    (real / "rgb/000003.jpg").write_bytes(data[: len(data) // 2])
    assert "000003.jpg: is cut off or damaged" in refusal(real, samples)


def test_files_that_do_not_fit_together_are_reported(real, samples):
    (real / "depth/000003.png").unlink()
    assert "gray has a picture 000003, and depth has none" in refusal(
        real, samples
    ) or "rgb has a picture 000003, and depth has none" in refusal(real, samples)
    cv2.imwrite(str(real / "depth/000003.png"), np.full((60, 80), 5000, np.uint16))
    assert "80 x 60 pixels, the rgb picture 160 x 120" in refusal(real, samples)
    for name in ("rgb", "gray", "depth"):
        shutil.rmtree(real / name)
    assert "has no pictures: put them into the folders rgb, gray and depth" in refusal(
        real, samples
    )


@pytest.mark.parametrize(
    ("scale_m", "what"),
    [
        (None, "give the scale"),
        (1.0, "are allowed: if the unit is millimetres, give a scale of 0.001"),
        (1e-7, "m is the least allowed: correct the scale"),
    ],
)
def test_a_wrong_scale_of_depth_is_reported(real, samples, scale_m, what):
    assert what in refusal(real, samples, scale_m=scale_m)


def test_a_missing_camera_is_an_error_with_a_remedy(real, samples):
    assert "give the intrinsics" in refusal(real, samples, K=None)


def coco_damage(change):
    return lambda real: flip(real / "annotations" / "instances_train.json", change)


LABEL_DAMAGE = {
    "a picture without annotation": (
        coco_damage(lambda c: c["images"].pop()) , "category|has no annotation|not list"
    ),
    "a corner outside": (
        coco_damage(lambda c: c["annotations"][0].update(segmentation=[[0, 0, 170.5, 0, 5, 5]])),
        r"corner \(170.5, 0\) lies outside of the picture of 160 x 120",
    ),
    "two corners": (
        coco_damage(lambda c: c["annotations"][0].update(segmentation=[[0, 0, 5, 5]])),
        "has 2 corners",
    ),
    "no area": (
        coco_damage(lambda c: c["annotations"][0].update(segmentation=[[5, 5, 5, 5, 5, 5]])),
        "covers no pixel",
    ),
    "no polygon": (
        coco_damage(lambda c: c["annotations"][0].update(segmentation=[])), "has no polygon"
    ),
    "a mask of another size": (
        coco_damage(
            lambda c: c["annotations"][0].update(
                segmentation={"size": [12, 16], "counts": [192]}
            )
        ),
        "its mask is",
    ),
    "an image of another size": (
        coco_damage(lambda c: c["images"][0].update(width=161)), "annotate the same picture"
    ),
    "an unknown category": (
        coco_damage(lambda c: c["annotations"][0].update(category_id=77)), "category 77"
    ),
    "no categories": (coco_damage(lambda c: c.pop("categories")), "not a COCO file of instances"),
    "no JSON": (
        lambda real: (real / "annotations/instances_train.json").write_text("{"),
        "cannot be read as JSON",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LABEL_DAMAGE)
def test_broken_annotations_are_reported(real, samples, name):
    damage, what = LABEL_DAMAGE[name]
    damage(real)
    assert re.search(what, refusal(real, samples))


def test_unusable_labelme_files_are_reported(real, samples):
    labelme(real, samples, imageWidth=80)
    assert "lies outside of the picture of 80 x 120" in refusal(real, samples)
    labelme(real, samples)
    flip(real / "annotations/000003.json", lambda c: c["shapes"][0].update(shape_type="circle"))
    assert "is a circle: draw instances as polygons" in refusal(real, samples)
    (real / "annotations/000003.json").unlink()
    assert "has no annotation of the picture 000003" in refusal(real, samples)


def run(*words):
    """Run a command of the command line."""
    return main([*map(str, words), "--debug"])


@pytest.mark.slow
def test_the_commands_report_their_result_and_missing_data(real, samples, capsys):
    out, coco = real.parent / "out", real.parent / "coco"
    arguments = ["--scale", SCALE_M, "--intrinsics", "212,214,78.3,61.7"]
    assert run("dataset", "import", real, "--out", out, *arguments) == 0
    output = capsys.readouterr().out
    assert "2 pictures" in output and "1 box, 2 wedge" in output
    assert "not known: poses, models" in output
    np.testing.assert_array_equal(open_examples(out)[0].K, K_of(samples))
    assert (
        run("dataset", "export", out, "--format", "coco", "--out", coco, "--shares", "0.5,0.5") == 0
    )
    assert "coco, scenes: train 1, val 1" in capsys.readouterr().out
    with pytest.raises(DatasetError, match="choose one of train, val"):
        open_examples(coco, split="test")


def test_a_lens_with_distortion_is_kept_as_stated(real, samples, capsys):
    distortion = (-0.1, 0.02, 1e-3, -1e-3, 0.0)
    out, _ = imported(real, samples, distortion=distortion)
    assert validate(out) == ()
    assert open_examples(out)[0].distortion == distortion
    with pytest.raises(SystemExit):
        run("dataset", "import", real, "--out", out, "--distortion", "0.1,0.2")
    assert "'0.1,0.2' is not five numbers k1,k2,p1,p2,k3" in capsys.readouterr().err


def test_a_picture_that_was_changed_after_the_import_is_detected(real, samples):
    """The changed picture is valid, so only its SHA-256 shows the change."""
    out, _ = imported(real, samples)
    path = out / "train" / "000000" / "rgb" / "000000.png"
    cv2.imwrite(str(path), cv2.imread(str(path)) // 2)
    for fast in (False, True):
        (problem,) = validate(out, fast=fast)
        assert problem.scene == 0
        assert "rgb/000000.png is not as it was written" in problem.what


def test_depth_outside_the_range_of_the_scanner_given_by_like_is_refused(
    simulation, real, samples, capsys
):
    out, like = real.parent / "out", simulation[0] / "master"
    arguments = ["--intrinsics", "212,214,78.3,61.7", "--like", like, "--out", out]
    for factor in (10, 0.1):
        with pytest.raises(GraycastError, match=r"of --like measures .*: probably .* another unit"):
            run("dataset", "import", real, "--scale", factor * SCALE_M, *arguments)
    assert not out.exists()
    assert run("dataset", "import", real, "--scale", SCALE_M, *arguments) == 0
    assert "note:" not in capsys.readouterr().out


def test_holes_filled_with_the_farthest_depth_are_named(real, samples):
    path = real / "depth" / "000003.png"
    steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    steps[::2, ::2] = steps.max() + 1
    cv2.imwrite(str(path), steps)
    (note,) = imported(real, samples)[1].notes
    assert note.startswith(f"{path}: ") and "holes that were filled" in note
