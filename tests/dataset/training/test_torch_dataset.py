"""The dataset class for PyTorch, with a stub of the three names that it uses, and with PyTorch."""

import importlib
import sys
from types import ModuleType

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.dataset.training import open_examples

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

NAME = "graycast.dataset.training.torch_dataset"


@pytest.fixture
def torch_dataset(monkeypatch):
    """Import the module with a stub whose tensors are arrays; PyTorch refuses read-only ones."""

    def from_numpy(array):
        assert array.flags.writeable
        return array

    torch, utils, data = (ModuleType(name) for name in ("torch", "torch.utils", "torch.utils.data"))
    torch.from_numpy, data.Dataset, torch.utils, utils.data = from_numpy, object, utils, data
    for module in (torch, utils, data):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.delitem(sys.modules, NAME, raising=False)
    yield importlib.import_module(NAME)
    sys.modules.pop(NAME, None)


def check(item, example):
    assert item["rgb"].shape == (3, 120, 160)
    np.testing.assert_array_equal(np.moveaxis(np.asarray(item["rgb"]), 0, -1), example.rgb)
    np.testing.assert_array_equal(np.asarray(item["depth"])[0], example.depth_m)
    np.testing.assert_array_equal(np.asarray(item["scanner_depth"])[0], example.scanner_depth_m)
    np.testing.assert_array_equal(np.asarray(item["masks"]), example.mask)
    np.testing.assert_array_equal(np.asarray(item["labels"]), example.obj_id)
    np.testing.assert_allclose(np.asarray(item["poses"]), example.T_cam_part, atol=1e-6)
    for box, mask in zip(np.asarray(item["boxes"]), example.mask, strict=True):
        y, x = mask.nonzero()
        assert box.tolist() == [x.min(), y.min(), x.max() + 1, y.max() + 1]


def test_items_are_tensors_in_the_shapes_of_torchvision(torch_dataset, master):
    data = torch_dataset.TorchExamples(master)
    assert len(data) == 4
    check(data[1], open_examples(master)[1])
    assert set(data[1]) == {
        "rgb", "gray", "depth", "scanner_depth", "masks", "boxes", "labels", "poses", "K",
        "scene_id",
    }  # fmt: skip


def test_data_that_an_export_lacks_are_not_among_the_keys(torch_dataset, exported):
    data = torch_dataset.TorchExamples(exported("yolo"), transform=sorted)
    assert data[0] == ["boxes", "labels", "masks", "rgb", "scene_id"]


def test_the_error_for_missing_pytorch_names_the_package_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, NAME, raising=False)
    with pytest.raises(GraycastError, match="pip install torch"):
        importlib.import_module(NAME)


@pytest.mark.slow
def test_a_pytorch_loader_reads_the_dataset_in_worker_processes(master):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: run pip install torch")
    from graycast.dataset.training.torch_dataset import TorchExamples

    loader = torch.utils.data.DataLoader(
        TorchExamples(master), batch_size=2, collate_fn=list, num_workers=2
    )
    items = [item for batch in loader for item in batch]
    for item, example in zip(items, open_examples(master), strict=True):
        check(item, example)
