"""No drawn view sees a corner of the bin beyond the domain's reach, which is not much larger."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from backends import slow

from graycast.base.frames import inverse, transform_points
from graycast.cell.config import Config
from graycast.cell.domain import deepest_m, draw, vary
from graycast.cell.resolve import reach_m, resolve_cell

ADAPTED = {
    "kind": "adapted",
    "camera": {"position_m": 0.01, "rotation_deg": 2},
    "bin": {"position_m": 0.02, "rotation_deg": 40},
}


@pytest.mark.slow
@pytest.mark.parametrize("domain", [slow(None), slow("randomized"), ADAPTED])
def test_no_drawn_view_puts_the_bin_deeper_than_the_computed_reach(domain):
    settings = {"parts": [{"builtin": "metal_workpiece_1"}], "view": {"tilt_deg": 12}}
    cell = resolve_cell(Config.model_validate(settings | {"domain": domain}), Path("."))
    limit_m, depths_m = deepest_m(cell.config.domain, cell.scene), []
    for seed in range(1 if domain is None else 150):
        scene = cell.scene
        if cell.domain is not None:
            record = draw(cell.domain, scene, (1,), np.random.default_rng(seed))
            scene = vary(cell.domain, scene, (1,), record).scene
        corner_m = np.array(list(itertools.product(*scene.bin.bounds_m.T)))
        depths_m.append(transform_points(inverse(scene.T_world_cam), corner_m)[:, 2].max())
    assert max(depths_m) <= limit_m * 1.001
    assert limit_m < max(depths_m) + 0.06
    assert reach_m(cell) == max(limit_m, cell.scene.rig.far_m)
