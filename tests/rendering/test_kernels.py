"""Values that change between scenes are not compiled into kernels, which cost a second each."""

import numpy as np
import pytest
from stage import (
    SOMEWHERE,
    box_part,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    make_rig,
    plain_pattern,
    turned,
    wall,
)

from graycast.base.frames import rigid
from graycast.rendering import Quality
from graycast.world.scene import Environment, Lamp


@pytest.mark.slow
def test_changing_seed_pose_colour_lamp_layout_or_count_compiles_no_kernel(mitsuba_renderer):
    """This covers light, truth and silhouettes; 40 and 70 parts need more than one word of bits."""
    import drjit as dr

    rig = make_rig(centred(32, 24, 40), centred(16, 12, 20))
    quality = Quality(samples=2, depth=2)

    def compiled(seed, count):
        rng = np.random.default_rng(seed)
        T_world_cam = rigid(turned(*rng.uniform(-0.1, 0.1, 3)), rng.uniform(-0.1, 0.1, 3))
        places = rng.uniform([-0.2, -0.2, 0.6], [0.2, 0.2, 1.0], (count, 3))
        poses = [rigid(turned(*rng.uniform(-1, 1, 3)), place) for place in places]
        part = box_part(rng.uniform(0.02, 0.06, 3), lambert(rng.uniform(0.2, 0.8)))
        level = rng.uniform(0.1, 1.0)
        scene = in_camera(
            rig,
            wall(1.2, lambert(rng.uniform(0.2, 0.8))),
            T_world_cam=SOMEWHERE @ T_world_cam,
            parts=(part,),
            environment=Environment(radiance=(level, level, level)),
            lamps=(Lamp(center_m=tuple(rng.uniform(2, 3, 3)), size_m=rng.uniform(0.1, 0.5)),),
        )
        layout = layout_in_camera([0] * count, poses, SOMEWHERE @ T_world_cam)
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            mitsuba_renderer.render(
                scene, layout, plain_pattern(rig, 255), quality=quality, seed=seed
            )
            history = dr.kernel_history([dr.KernelType.JIT])
        assert sum(kernel["size"] >= 32 * 24 for kernel in history) >= 3
        # A kernel that an earlier run left on the disk is new to this process, too.
        return sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in history)

    compiled(0, 3)
    assert [compiled(1, 3), compiled(2, 40), compiled(3, 70), compiled(4, 2)] == [0, 0, 0, 0]
