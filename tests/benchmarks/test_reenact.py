"""The re-enactment of a simulated scan, whose materials are known."""

import cv2
import numpy as np
import pytest

import graycast as gc
from benchmarks import reenact
from graycast.camera.stack import read_description
from graycast.camera.stack.stack_pictures import read_pictures

MATT = {"base_color": (0.5,) * 3, "specular": 0.0, "roughness": 1.0}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    out = tmp_path_factory.mktemp("scan") / "bin"
    config = gc.Config(
        parts=(gc.PartSection(builtin="metal_workpiece_1", material="plastic"),),
        count=16,
        rig="like-phoxi-m",
        resolution="small",
        bin={"inner_m": (0.30, 0.22, 0.06), "material": MATT},
        table=MATT,
        store={"frames": True},
        render={"denoise": False},
        exposure={"factors": (1.0,)},
    )
    gc.generate(gc.load_cell(config), out, scenes=1, seed=5)
    return out / "train" / "000000"


@pytest.mark.slow
def test_a_simulated_scan_is_predicted_from_its_own_depth(scene, tmp_path):
    """A wrong material, normal or vignetting would change the percentiles of the light."""
    masks = [cv2.imread(str(path), 0) for path in (scene / "mask_sl").glob("*.png")]
    cv2.imwrite(str(tmp_path / "parts.png"), np.max(masks, axis=0))
    stack, rig = scene / "frames" / "stack.yaml", scene / "frames" / "rig.yaml"
    figures = reenact.measure(
        stack, rig, [tmp_path / "parts.png"], 0.5, False, tmp_path / "out", 32, lambda text: None
    )
    parts, rest, _ = figures["rows"]
    assert abs(parts["roughness"] - 0.5) < 0.02 and abs(parts["color"] - 0.3) < 0.015
    for row in (parts, rest):
        assert row["error %"][0] < 8
        np.testing.assert_allclose(*row["percentiles"], rtol=0.06)
    assert rest["rank"][0] > 0.9  # Speckle hides the small differences between the parts' faces.
    assert (tmp_path / "out" / "reenactment.png").stat().st_size > 20_000


STACK = """\
projector: {width_px: 64, height_px: 32}
frames:
  - {file: lit/white.jpg, kind: white}
  - {file: ../phases/0.tif, kind: phase, axis: column, period_px: 8.5, step: 0.5, steps: 3}
  - {file: /scans/1.png, kind: phase, axis: column, period_px: 8.5, step: 1.5, steps: 3}
  - {file: column/white.jpg, kind: phase, axis: column, period_px: 8.5, step: 2.5, steps: 3}
offset_px: {column: 2.5}
levels: {saturation_dn: 4000}
rig: ../rig.yaml
"""


def test_simulated_pictures_are_written_for_a_stack_whose_pictures_are_in_many_folders(tmp_path):
    """Law: what is written is read again, bit by bit, and the frames stay the same."""
    stack = tmp_path / "real" / "my_stack.yaml"
    stack.parent.mkdir()
    stack.write_text(STACK)
    pictures = list(np.random.default_rng(1).integers(0, 4096, (4, 5, 7)).astype(np.uint16))
    reenact.write_pictures(stack, pictures, tmp_path / "out" / "stack")
    real, own = (
        read_description(path) for path in (stack, tmp_path / "out" / "stack" / "stack.yaml")
    )
    assert [one.frame() for one in own.frames] == [one.frame() for one in real.frames]
    assert (own.offset_px, own.levels, own.rig) == (real.offset_px, real.levels, None)
    files = [tmp_path / "out" / "stack" / one.file for one in own.frames]
    np.testing.assert_array_equal(read_pictures(files).frames, pictures)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "real"]
