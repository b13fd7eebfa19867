"""Make a folder of picks by hand, without light, physics or a planner, for tests of the page.

There are two boxes in a small bin and three scans. One box is picked, the other box is lost during
the motion, and then no box is detected.
"""

import numpy as np
from small_cell import write_cell

from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.rig.meshdepth import rasterize
from graycast.robot.pick import Attempt, Outcome, load_pick_config, resolve_pick_cell
from graycast.robot.pick.arm.robot import open_robot
from graycast.robot.pick.bin.episode import Episode
from graycast.robot.pick.results.pick_files import episode_files, open_picks
from graycast.robot.pick.tool.tools import T_flange_tip
from graycast.world.scene import bin_mesh

STEP_S, GRIP, STEPS = 0.05, 20, 45
LOST_S = 0.4
FROM_GRIP_TO_PART = rigid(axis_rotation("z", 0.3), np.array([0.004, -0.002, -0.015]))


def write_picks(folder, *, bins=(0, 2), **changes):
    """Write the picks; return their folder and the cell's file."""
    options = {"robot": {"arm": "ur5e", "base_m": [-0.5, 0.0, 0.0]}, **changes}
    path = write_cell(folder, "scenes", **options)
    config = load_pick_config(path)
    cell = resolve_pick_cell(config, folder)
    with open_picks(folder / "picks", cell, seed=0) as picks:
        for bin_id in bins:
            picks.write(bin_id, episode_files(episode(cell, bin_id)))
    return folder / "picks", path


def episode(cell, bin_id):
    robot = open_robot(cell.config.robot.arm, folder=cell.folder)
    first, T_first = motion(robot, cell, place_m=(0.05, 0.03 + 0.01 * bin_id, 0.03))
    second, T_second = motion(robot, cell, place_m=(-0.06, -0.03, 0.03))
    lay = np.stack([T @ FROM_GRIP_TO_PART for T in (T_first, T_second)])
    fell = rigid(np.eye(3), np.array([0.03, 0.02, 0.015]))
    fields = {"targets": 2, "kind": 0, "score": 0.9, "least_factor": 1.4}
    attempts = (
        attempt(Outcome.PICKED, lay, (0, 1), part=0, T=T_first, moved=first, **fields),
        attempt(
            Outcome.LOST_SEAL, lay[1:], (1,), part=1, T=T_second, moved=second, lost_s=LOST_S,
            detail="after 0.40 s, by 9.0 N and 0.20 Nm", **fields,
        ),
        attempt(Outcome.NOTHING_FOUND, fell[None], (1,), targets=0),
    )  # fmt: skip
    camera = cell.cell.scene.rig.camera
    size = (camera.height_px, camera.width_px)
    return Episode(
        bin_id=bin_id,
        kinds=(0, 0),
        attempts=attempts,
        pictures=tuple(np.full((*size, 3), 60 + 50 * k, np.uint8) for k in range(3)),
        depths_m=tuple(depth(cell, one.T_world_part) for one in attempts),
        filled=2,
        taken=1,
        left=1,
    )


def attempt(outcome, lay, present, *, T=None, moved=None, **fields):
    time_s = None if moved is None else STEP_S * np.arange(len(moved))
    return Attempt(
        outcome=outcome,
        T_world_part=lay,
        present=present,
        seconds={"scan": 0.1, "motion": 0.0 if moved is None else float(time_s[-1])},
        work_s={"scan": 0.5, "detect": 0.1, "plan": 0.2},
        T_world_tool=T,
        time_s=time_s,
        q=moved,
        **fields,
    )


def motion(robot, cell, *, place_m):
    """Return angles from home to a grip and up to the other side, and `T_world_tip` at the grip."""
    T = rigid(axis_rotation("z", 0.4), np.array(place_m))
    T_flange = inverse(cell.T_world_base) @ T @ inverse(T_flange_tip(cell.config.tool))
    down = robot.reach(T_flange, robot.home, seed=0)[0]
    away = robot.home + np.resize([-1.2, 0.1, 0.1, -0.2, 0.1, -0.6], len(robot.home))
    to = np.linspace(robot.home, down, GRIP, endpoint=False)
    return np.vstack([to, np.linspace(down, away, STEPS - GRIP)]), T


def depth(cell, T_world_part):
    """Return z of the nearest surface of the bin and the parts."""
    scene = cell.cell.scene
    T_cam_world, camera = inverse(scene.T_world_cam), scene.rig.camera
    things = [(bin_mesh(scene.bin), np.eye(4))]
    things += [(scene.parts[0].mesh, T) for T in T_world_part]
    z = np.full((camera.height_px, camera.width_px), np.nan)
    for mesh, T in things:
        place = T_cam_world @ T
        vertices_m = mesh.vertices_m @ place[:3, :3].T + place[:3, 3]
        _, mine = rasterize(vertices_m.astype(np.float64), mesh.faces.astype(int), camera).over(
            camera
        )
        z = np.fmin(z, mine)
    return z


def T_world_part(motion, i, T_world_before):
    """Return the pose of the part at time `i`; None before the grip and after the release."""
    until_s = motion.held_until_s
    if until_s is None or not motion.time_s[motion.grip] <= motion.time_s[i] <= until_s:
        return None
    at_grip = motion.T_world_limb[motion.grip, motion.carrier]
    return motion.T_world_limb[i, motion.carrier] @ inverse(at_grip) @ T_world_before
