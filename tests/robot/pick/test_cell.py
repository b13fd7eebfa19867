"""Robot cells that cannot work are refused in one line that names the reason."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from backends import slow
from small_cell import write_cell

from graycast.base.errors import GraycastError
from graycast.base.frames import rigid
from graycast.dataset.read.detections import Detections
from graycast.robot.grasp import DepthView
from graycast.robot.pick import load_pick_config, resolve_pick_cell
from graycast.robot.pick.bin.bin_scan import BinScan, targets
from graycast.robot.pick.bin.ready import make_ready
from graycast.world.scene import Layout

URDF = """<robot name="r"><link name="base"/><link name="{last}"/>
<joint name="j" type="revolute"><parent link="base"/><child link="{last}"/>
<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="0"/>
</joint>{more}</robot>"""
MESH = """<link name="l2"><collision><geometry><mesh filename="gone.stl"/></geometry></collision>
</link><joint name="f" type="fixed"><parent link="base"/><child link="l2"/></joint>"""


def ready(folder, **changes):
    path = write_cell(folder, **changes)
    return make_ready(resolve_pick_cell(load_pick_config(path), folder))


@pytest.mark.slow
def test_the_small_cell_itself_is_accepted(robots, tmp_path):
    setup = ready(tmp_path)
    assert (
        setup.known[0].grips
        and setup.robot.touches(setup.here.q_place, setup.here.standing) is None
    )


def test_a_robot_picks_with_a_preset_scanner(tmp_path):
    path = write_cell(tmp_path, rig="like-zivid-2-m70", view={"distance_m": 0.8})
    cell = resolve_pick_cell(load_pick_config(path), tmp_path)
    assert cell.cell.scanner.rig.name == "like-zivid-2-m70"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": {"arms": "ur5e"}}, "robot.arms: did you mean arm?"),
        ({"tool": {"kind": "magnet"}}, "tool"),
        ({"tool": {"kind": "suction", "cup": {"radius": 0.01}}}, "did you mean radius_m"),
        ({"tool": {"kind": "suction", "cup": {"radius_m": -1.0}}}, "radius_m is -1"),
        ({"tool": {"kind": "suction", "cup": {"radius_m": 15.0}}}, "give metres"),
        ({"tool": {"kind": "suction", "cup": {"vacuum_pa": 2.0e5}}}, "101325"),
        ({"tool": {"kind": "jaws"}, "picking": {"knows": "depth"}}, "jaws need a known model"),
        ({"picking": {"knows": "part", "detector": "none"}}, "needs a detector"),
        ({"picking": {"detector": "nowhere"}}, "nowhere"),
        (
            {"picking": {"depth": "noisy"}},
            "depth: noisy and depth_noise_m are used only together: give both or",
        ),
        (
            {"picking": {"place_m": [0.0, 0.0, 0.3]}},
            "which is over the bin: give a place beside the bin",
        ),
        ({"picking": {"most_lean_deg": 95}}, "most_lean_deg"),
        ({"domain": {"kind": "adapted"}}, "remove domain"),
    ],
)
def test_wrong_values_in_the_file_are_refused_by_name(tmp_path, changes, words):
    refuses(tmp_path, changes, words)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": {"arm": "ur10"}}, "the robot 'ur10' is not known"),
        ({"robot": {"arm": "broken.urdf"}}, "broken.urdf"),
        ({"robot": {"arm": "headless.urdf"}}, "no link called flange"),
        ({"robot": {"arm": "meshless.urdf"}}, "gone.stl"),
        ({"robot": {"home_rad": [0, 0]}}, "home has 2 angles"),
        ({"robot": {"home_rad": [9, 0, 0, 0, 0, 0]}}, "home of joint 1"),
        ({"robot": {"home_rad": [0, 0.6, 0, 0, 0, 0]}}, "the arm collides with"),
        ({"robot": {"base_m": [-2.5, 0, 0]}}, "does not reach"),
        ({"tool": {"kind": "suction", "cup": {"vacuum_pa": 50.0}}}, "holds part box"),
        ({"tool": {"kind": "jaws", "jaws": {"opening_m": 0.02}}}, "holds part box"),
        ({"picking": {"place_m": [0.0, -0.4, 0.02]}}, "the arm with a part of up to"),
    ],
)
def test_settings_beyond_the_robot_or_tool_are_refused_by_name(robots, tmp_path, changes, words):
    (tmp_path / "broken.urdf").write_text("<robot", encoding="utf-8")
    (tmp_path / "headless.urdf").write_text(URDF.format(last="hand", more=""), encoding="utf-8")
    text = URDF.format(last="flange", more=MESH)
    (tmp_path / "meshless.urdf").write_text(text, encoding="utf-8")
    refuses(tmp_path, changes, words)


def refuses(folder, changes, words):
    with pytest.raises(GraycastError, match=words) as refused:
        ready(folder, **changes)
    assert "\n" not in str(refused.value).strip()


class OneClass:
    """A detector that finds one part of its only class, and omits ids below 0."""

    about = SimpleNamespace(names=("part",))

    def detect(self, example, *, obj_ids, least_score):
        kind = np.array([obj_ids["part"]])
        known = kind >= 0
        box = np.array([[5.0, 5.0, 20.0, 10.0]])[known]
        return Detections(scene_id=0, score=np.array([0.9])[known], obj_id=kind[known], box_px=box)


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, slow(2)])
def test_a_detector_with_one_class_is_accepted_if_grips_need_no_model(
    robots, tmp_path, monkeypatch, parts
):
    """With one part, the class is this part; with two parts it is unknown, which needs `depth`."""
    monkeypatch.setattr("graycast.robot.pose.closest.CELLS", 20)  # No pose is estimated.
    detect = SimpleNamespace(load_detector=lambda path: OneClass())  # This avoids PyTorch.
    monkeypatch.setitem(sys.modules, "graycast.learn.detect", detect)
    (tmp_path / "run").mkdir()
    mix = [{"mesh": "box.stl", "unit": "mm", "name": name} for name in ("box", "crate")[:parts]]
    changes = {"parts": mix, "tool": {"kind": "suction"}}
    setup = ready(tmp_path, **changes, picking={"knows": "depth", "detector": "run"})
    camera, blank = setup.cell.cell.scene.rig.camera, np.zeros((120, 160))
    look = BinScan(
        view=DepthView(depth_m=blank + 1, camera=camera, T_world_cam=rigid(np.eye(3), np.zeros(3))),
        gray=blank.astype(np.uint8),
        rgb=np.zeros((120, 160, 3), np.uint8),
        instance=blank.astype(int),
        seconds=0.1,
    )
    nowhere = Layout(T_world_part=np.zeros((0, 4, 4)), part_index=np.zeros(0, int))
    (candidate,) = targets(setup.cell, look, nowhere, OneClass())
    assert candidate.kind == (0 if parts == 1 else None)
    if parts == 2:
        with pytest.raises(GraycastError, match="it knows part, and the cell has box, crate"):
            ready(tmp_path, **changes, picking={"knows": "part", "detector": "run"})
