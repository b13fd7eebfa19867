"""COCO files, read by pycocotools."""

import contextlib
import io

import numpy as np
import pytest
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO

from graycast.dataset.write.coco import run_lengths
from graycast.rendering.radiance import Silhouette

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def load(path):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(str(path))


@pytest.mark.parametrize("window", [(3, 5, 9, 11), (0, 0, 20, 30), (19, 29, 20, 30), (0, 7, 1, 8)])
@pytest.mark.parametrize("density", [0.5, 1.0])
def test_run_lengths_equal_those_of_pycocotools(window, density):
    top, left, bottom, right = window
    rng = np.random.default_rng(8)
    image = np.zeros((20, 30), dtype=bool)
    image[top:bottom, left:right] = rng.random((bottom - top, right - left)) < density
    crop = Silhouette(left_px=left, top_px=top, mask=image[top:bottom, left:right].copy())
    runs = run_lengths(crop, height_px=20, width_px=30)
    assert sum(runs) == image.size
    compressed = coco_mask.frPyObjects({"counts": runs, "size": [20, 30]}, 20, 30)
    encoded = coco_mask.encode(np.asfortranarray(image, dtype=np.uint8))
    assert compressed["counts"] == encoded["counts"]


def test_the_split_has_every_visible_instance_of_every_scene(dataset, samples):
    coco = load(dataset / "train_coco.json")
    assert coco.getImgIds() == [0, 3]
    assert [c["name"] for c in coco.loadCats(coco.getCatIds())] == ["box", "wedge"]
    for image in coco.loadImgs(coco.getImgIds()):
        sample = samples[image["id"]]
        with Image.open(dataset / image["file_name"]) as picture:
            assert picture.size == (image["width"], image["height"])
            assert np.array_equal(np.array(picture), sample.rgb)
        anns = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        instances = [i for i in range(8) if (sample.truth.instance == i).any()]
        assert 4 <= len(instances) == len(anns) < 8
        for i, ann in zip(instances, anns, strict=True):
            mask = coco.annToMask(ann).astype(bool)
            assert np.array_equal(mask, sample.truth.instance == i)
            y, x = mask.nonzero()
            assert ann["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
            assert ann["area"] == mask.sum()
            assert ann["category_id"] == sample.layout.part_index[i] + 1
            whole = sample.truth.amodal[i].mask.sum()
            assert ann["visib_fract"] == pytest.approx(mask.sum() / whole)


@pytest.mark.parametrize(("suffix", "picture"), [("", "rgb"), ("_sl", "gray_sl")])
def test_a_scene_file_has_visible_masks_and_amodal_boxes_like_bop_toolkit(
    dataset, samples, suffix, picture
):
    scene = dataset / "train" / "000003"
    coco = load(scene / f"scene_gt_coco{suffix}.json")
    (image,) = coco.loadImgs(coco.getImgIds())
    assert (image["id"], image["file_name"]) == (0, f"{picture}/000000.png")
    assert (scene / image["file_name"]).is_file()
    truth = samples[3].truth
    instances = [i for i in range(8) if (truth.instance == i).any()]
    anns = coco.loadAnns(coco.getAnnIds())
    assert [ann["id"] for ann in anns] == list(range(1, len(instances) + 1))
    for i, ann in zip(instances, anns, strict=True):
        assert isinstance(ann["segmentation"]["counts"], list)
        assert np.array_equal(coco.annToMask(ann).astype(bool), truth.instance == i)
        y, x = truth.amodal[i].in_image(*truth.instance.shape).nonzero()
        assert ann["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
        fraction = (truth.instance == i).sum() / truth.amodal[i].mask.sum()
        assert ann["ignore"] == (fraction < 0.1)
