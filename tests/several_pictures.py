"""A small finished dataset of two scanners with two views each, in closed form.

Boxes and wedges are on the floor of one world, and four cameras see them. The pictures of the two
scanners have different sizes. Only the first picture has a hole.
"""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from graycast.base.frames import axis_rotation, inverse, look_at, pixel_grid, rigid
from graycast.base.streams import scene_seeds
from graycast.camera.decode import DepthMap, Reason
from graycast.dataset.files.sample import Sample
from graycast.dataset.write.claim import Taker
from graycast.dataset.write.store import open_store
from graycast.rendering.radiance import GroundTruth, Silhouette
from graycast.rig.optics import Optics, rays
from graycast.rig.pair import Rig
from graycast.world.scene import Layout, Scene

sys.path.append(str(Path(__file__).parent / "dataset"))
from prisms import CONFIG, SCALE_MM, SEED, box_part, hit_depth, pictures, wedge_part

NAMES = ("left-0", "left-1", "right-0", "right-1")
SCENES = (0, 3)
SIGMA_M = 0.1e-3
HOLE = np.s_[40:60, 60:90]  # the hole in the first picture
_EYES = ((-0.25, 0.0, 0.6), (0.0, -0.3, 0.6), (0.25, 0.05, 0.6), (0.0, 0.3, 0.55))


def rigs():
    """Return two rigs: `left` with 160 x 120 pixels, and `right` with 128 x 96."""
    by_name = {}
    for name, (width, height, f) in {"left": (160, 120, 200.0), "right": (128, 96, 150.0)}.items():
        camera = Optics(
            width_px=width, height_px=height, fx_px=f, fy_px=f,
            cx_px=(width - 1) / 2, cy_px=(height - 1) / 2,
        )  # fmt: skip
        aside = rigid(np.eye(3), np.array([0.2, 0.0, 0.0]))
        by_name[name] = Rig(
            name=name, camera=camera, projector=camera, T_cam_proj=aside, near_m=0.2, far_m=1.5
        )
    return by_name


def lying(scene_id):
    """Return the poses of five parts on the floor that do not intersect."""
    rng = np.random.default_rng(scene_id)
    place = [(-0.08, -0.05), (0.08, -0.05), (0.0, 0.07), (-0.09, 0.06), (0.0, -0.03)]
    return np.stack(
        [rigid(axis_rotation("z", rng.uniform(0, 6)), np.array([x, y, 0.02])) for x, y in place]
    )


def sample_of(scene_id, place):
    name, image = NAMES[place].split("-")
    rig, parts, pose = rigs()[name], (box_part(), wedge_part()), lying(scene_id)
    T = look_at(np.array(_EYES[place]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    rng = np.random.default_rng([scene_id, place])
    camera = rig.camera
    ray = rays(camera, pixel_grid(camera.height_px, camera.width_px))
    part_index = np.arange(len(pose)) % 2
    layer = [
        hit_depth(parts[p].mesh, inverse(T) @ at, ray[..., 0], ray[..., 1])
        for p, at in zip(part_index, pose, strict=True)
    ]
    floor = -T[2, 3] / (ray @ T[2, :3])
    layers = np.stack([floor, *layer])
    nearest = np.nanargmin(layers, axis=0)
    depth_m = np.take_along_axis(layers, nearest[None], axis=0)[0]
    reason = np.zeros(depth_m.shape, dtype=np.uint8)
    if place == 0:
        reason[HOLE] = Reason.SATURATED
    rgb, gray, modulation = pictures(nearest - 1, np.zeros(reason.shape, bool), rng)
    measured = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
    return Sample(
        scene=Scene(rig=rig, T_world_cam=T, parts=parts),
        layout=Layout(T_world_part=pose, part_index=part_index),
        truth=GroundTruth(
            depth_m=depth_m,
            normal=np.full((*depth_m.shape, 3), np.nan),
            instance=nearest - 1,
            amodal=tuple(Silhouette(left_px=0, top_px=0, mask=~np.isnan(z)) for z in layer),
        ),
        rgb=rgb,
        gray=gray,
        scanner_depth=DepthMap(
            depth_m=np.where(reason == 0, measured, np.nan),
            sigma_m=np.where(reason == 0, SIGMA_M, np.nan),
            reason=reason,
            camera=camera,
        ),
        modulation=modulation,
        manifest={
            "scene_id": scene_id,
            "dataset_seed": SEED,
            "seeds": scene_seeds(SEED, scene_id, domain=False),
            "counts": dict(Counter(parts[p].name for p in part_index)),
            "reasons": {r.name.lower(): float((reason == r).mean()) for r in Reason},
            "config": CONFIG,
            "timings": {"render_s": 1.5},
        },
        sensor=name,
        image=int(image),
    )


def write_several(out):
    """Write the dataset and return the samples by scene, in the order of `NAMES`."""
    parts = (box_part(), wedge_part())
    takers = tuple(Taker(name=n, images=2, rig=rig, scanning={}) for n, rig in rigs().items())
    samples = {i: [sample_of(i, place) for place in range(len(NAMES))] for i in SCENES}
    with open_store(
        out, config=CONFIG, seed=SEED, parts=parts, rig=takers[0].rig, depth_scale_mm=SCALE_MM,
        takers=takers,
    ) as store:  # fmt: skip
        for scene_id, views in samples.items():
            store.write(scene_id, views)
        store.finish(samples)
    return samples


@pytest.fixture(scope="session")
def several(tmp_path_factory):
    """Return the dataset and its samples; a test that changes them must copy them."""
    out = tmp_path_factory.mktemp("several") / "out"
    return out, write_several(out)
