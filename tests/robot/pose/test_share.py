"""Success rate of poses in simulated scans, as stated in docs/measurements/pose.md."""

from pathlib import Path

import numpy as np
import pytest

from graycast.base.frames import inverse
from graycast.cell.config import load_config
from graycast.cell.resolve import resolve_cell
from graycast.cell.simulate import make_scene
from graycast.robot.pose import find_pose, find_pose_in_box, pose_model
from graycast.score.evaluate import rotation_translation
from graycast.world.parts.symmetry import joined, motions, shape_symmetry

CONFIGS = Path(__file__).resolve().parents[3] / "configs" / "detector"
SCENE = 60  # The constants were chosen with other scenes.


@pytest.mark.slow
def test_nearly_all_poses_are_found_from_outlines_and_most_from_boxes(
    mitsuba_renderer,
):
    """Scenes of three parts with the rig `paper` have 63 instances that are visible to 70 %.

    The stated shares are 99.7 % and 95 %. With these shares, 3 of 63 poses from outlines fail once
    in 1000 seeds, and 9 of 63 poses from boxes fail once in 200 seeds. If every tenth pose from an
    outline were wrong, 3 poses would fail in 24 of 25 seeds.
    """
    right = np.array(
        [
            row
            for name in ("metal_workpiece_1", "metal_workpiece_2", "yellow_salt_cube")
            for row in successes(CONFIGS / f"{name}.yaml", mitsuba_renderer)
        ]
    )
    assert len(right) >= 50
    by_outline, by_box = (~right).sum(axis=0)
    assert by_outline <= 2 and by_box <= 8


def successes(path, renderer):
    """Yield whether an instance is within 5 degrees and 3 mm, from its outline and from its box."""
    cell = resolve_cell(load_config(path), path.parent)
    shot = make_scene(cell, SCENE, seed=0, renderer=renderer)
    sample, truth, (part,) = shot.sample, shot.rendering.truth, cell.scene.parts
    symmetry = joined(part.symmetry, shape_symmetry(part.mesh))
    model, middle_m = pose_model(part.mesh, symmetry), part.mesh.bounds_m.mean(axis=0)
    depth_m, camera = sample.scanner_depth.depth_m, sample.scene.rig.camera
    for i, T_world_part in enumerate(sample.layout.T_world_part):
        mask, whole_px = truth.instance == i, truth.amodal[i].mask.sum()
        if not whole_px or mask.sum() < 0.7 * whole_px:
            continue
        rows, columns = np.nonzero(mask)
        box = np.array([columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1], float)
        T = inverse(sample.scene.T_world_cam) @ T_world_part
        yield [
            near(one.T_cam_part, T, motions(symmetry), middle_m)
            for one in (
                find_pose(model, depth_m, camera, mask),
                find_pose_in_box(model, depth_m, camera, box),
            )
        ]


def near(T, true, alike, middle_m):
    if T is None:
        return False
    angle_rad, shift_m = rotation_translation(T, true, alike, middle_m=middle_m)
    return bool(np.degrees(angle_rad) <= 5 and shift_m <= 0.003)
