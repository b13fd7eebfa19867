"""The depth that the robot uses: the scanner's, perfect depth, or noisy depth."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.dataset.read.detections import Detections
from graycast.rendering import GroundTruth, Radiance, Renderer, Rendering
from graycast.robot.grasp import DepthView
from graycast.robot.pick import load_pick_config, resolve_pick_cell
from graycast.robot.pick.bin.bin_scan import BinScan, scan, targets
from graycast.world.scene import Layout

NOWHERE = Layout(T_world_part=np.zeros((0, 4, 4)), part_index=np.zeros(0, int))


class Unlit(Renderer):
    """A renderer of an inclined plane in light without a pattern, which no scanner can measure."""

    name, device, denoiser, versions = "unlit", "cpu", "oidn", {}

    def __init__(self):
        self.samples = []

    def render(self, scene, layout, pattern, *, quality, seed):
        self.samples.append(quality.samples)
        camera = scene.rig.camera
        shape = camera.height_px, camera.width_px
        self.depth_m = np.add.outer(np.linspace(0.5, 0.7, shape[0]), np.linspace(0, 0.1, shape[1]))
        color = np.ones((*shape, 3))
        return Rendering(
            radiance=Radiance(
                pattern=np.ones((len(pattern), *shape)),
                white=np.ones(shape),
                ambient=np.zeros(shape),
                white_rgb=color.copy(),
                ambient_rgb=color.copy(),
                albedo=color.copy(),
            ),
            truth=GroundTruth(
                depth_m=self.depth_m, normal=color, instance=np.full(shape, -1), amodal=()
            ),
        )


def scanned(folder, **picking):
    path = write_cell(folder, picking=picking, render={"samples": 8})
    cell, renderer = resolve_pick_cell(load_pick_config(path), folder), Unlit()
    looks = [scan(cell, renderer, NOWHERE, seed=np.random.SeedSequence(i)) for i in (1, 2)]
    return SimpleNamespace(
        depth_m=[look.view.depth_m for look in looks], truth=renderer.depth_m, all=renderer.samples
    )


def test_the_scanner_does_not_see_surfaces_without_the_pattern(tmp_path):
    scans = scanned(tmp_path)
    assert np.isnan(scans.depth_m[0]).mean() > 0.98  # In a few pixels, noise resembles a code.
    assert scans.all == [8, 8]


def test_perfect_depth_equals_the_truth_and_is_rendered_at_low_quality(tmp_path):
    scans = scanned(tmp_path, depth="perfect")
    np.testing.assert_array_equal(scans.depth_m[0], scans.truth)
    assert scans.all == [1, 1]


def test_noisy_depth_has_the_stated_gaussian_noise_and_differs_between_scans(tmp_path):
    scans = scanned(tmp_path, depth="noisy", depth_noise_m=1e-3)
    off = [depth_m - scans.truth for depth_m in scans.depth_m]
    n = off[0].size
    for noise in off:
        assert noise.std() == pytest.approx(1e-3, rel=5 / np.sqrt(2 * n))
        assert abs(noise.mean()) < 5e-3 / np.sqrt(n)
        assert np.mean(noise**4) / np.mean(noise**2) ** 2 == pytest.approx(
            3, abs=5 * (24 / n) ** 0.5
        )
    assert abs(np.corrcoef(off[0].ravel(), off[1].ravel())[0, 1]) < 5 / np.sqrt(n)


class OneBox:
    """A detector that finds one part, in the columns 40 to 59."""

    about = SimpleNamespace(names=("box",))

    def detect(self, example, *, obj_ids, least_score):
        box = np.array([[40.0, 10.0, 20.0, 50.0]])
        return Detections(
            scene_id=0, score=np.ones(1), obj_id=np.array([obj_ids["box"]]), box_px=box
        )


def test_a_detection_has_the_true_pose_of_the_part_with_most_of_its_pixels(tmp_path):
    """Seven columns of the detection show the first part, nine the second, and four no part."""
    path = write_cell(tmp_path, picking={"pose": "truth"})
    cell = resolve_pick_cell(load_pick_config(path), tmp_path)
    instance = np.full((120, 160), -1)
    instance[:, 40:47], instance[:, 47:56] = 0, 1
    T_world_cam = rigid(axis_rotation("x", np.pi), np.array([0.0, 0.1, 0.8]))
    look = BinScan(
        view=DepthView(depth_m=np.ones((120, 160)), camera=cell.cell.scene.rig.camera,
                   T_world_cam=T_world_cam),
        gray=np.zeros((120, 160), np.uint8), rgb=None, instance=instance, seconds=0.1,
    )  # fmt: skip
    poses = [rigid(axis_rotation("z", turn), np.array([turn, 0, 0.02])) for turn in (0.1, 0.2)]
    layout = Layout(T_world_part=np.stack(poses), part_index=np.array([0, 0]))
    (candidate,) = targets(cell, look, layout, OneBox())
    np.testing.assert_allclose(candidate.T_cam_part, inverse(T_world_cam) @ poses[1])
