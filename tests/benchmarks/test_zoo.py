"""The zoo: typical parts of bins come to rest, and another engine confirms their balance."""

import numpy as np
import pytest
import trimesh

from benchmarks import zoo
from benchmarks.balance import unbalanced_m
from benchmarks.zoo_parts import ZOO
from graycast.base.frames import axis_rotation, rigid
from graycast.world.drop.body import body_of
from graycast.world.drop.decomposition import hull_of
from graycast.world.drop.rapier import SKIN_M
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import Bin, Layout

BIN = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.3)


def rod(friction: float = 0.3):
    shape = trimesh.creation.box((0.1, 0.02, 0.02))
    part = Part(
        name="rod",
        mesh=Mesh(vertices_m=np.array(shape.vertices), faces=np.array(shape.faces)),
        material=Material(),
        density_kg_m3=7800.0,
        friction=friction,
    )
    return body_of(part, (hull_of(part.mesh.vertices_m),))


def lying(*poses) -> Layout:
    return Layout(T_world_part=np.stack(poses), part_index=np.zeros(len(poses), int))


def at(x_m: float, z_m: float, turn=None):
    return rigid(np.eye(3) if turn is None else turn, np.array([x_m, 0.0, z_m]))


@pytest.mark.slow
def test_two_stacked_rods_do_not_move():
    layout = lying(at(0, 0.01 + SKIN_M), at(0.03, 0.03 + 3 * SKIN_M))
    assert unbalanced_m(BIN, (rod(),), layout).max() < 20e-6


@pytest.mark.parametrize("beyond_m, falls", [(0.048, False), (0.053, True)])
def test_a_rod_falls_if_its_centre_of_mass_is_beyond_the_edge_of_its_support(beyond_m, falls):
    """Statics: the rod falls if its centre of mass is beyond the lower rod's end, at 50 mm."""
    layout = lying(at(0, 0.01 + SKIN_M), at(beyond_m, 0.03 + 3 * SKIN_M))
    moved_m = unbalanced_m(BIN, (rod(),), layout)
    assert moved_m[1] > 5e-3 if falls else moved_m[1] < 0.1e-3


@pytest.mark.parametrize("friction, slides", [(0.1, True), (0.7, False)])
def test_a_rod_leans_on_the_wall_if_friction_is_sufficient(friction, slides):
    """A ladder at angle a slides if tan a < (1 - mu^2) / (2 mu); here tan a = 1.19."""
    angle = np.deg2rad(50)
    turn = axis_rotation("y", -angle)
    corners = rod().box_m @ turn.T
    place = at(0.2 - SKIN_M - corners[:, 0].max(), SKIN_M - corners[:, 2].min(), turn)
    box = Bin(inner_m=(0.4, 0.3, 0.1), friction=friction)
    moved_m = unbalanced_m(box, (rod(friction),), lying(place))
    assert moved_m[0] > 5e-3 if slides else moved_m[0] < 0.5e-3


def dropped(*families, counts, seeds, hull_folder):
    settings = {"counts": counts, "seeds": seeds, "hull_folder": hull_folder}
    return zoo.measure(families=families, **settings, show=lambda text: None)["rows"]


@pytest.mark.slow
def test_bolts_come_to_rest_in_balance(tmp_path):
    """Symptom: a bolt on an empty floor never came to rest."""
    for row in dropped("hex_bolt", counts=(1, 10), seeds=2, hull_folder=tmp_path):
        assert (row["made"], row["most"], row["balanced"]) == (2, 1, 2), row


@pytest.mark.slow
def test_boxes_on_their_faces_are_in_balance(tmp_path):
    """With one or two points per contact, boxes moved by 1 to 41 mm (see balance.py)."""
    (row,) = dropped("yellow_salt_cube", counts=(7,), seeds=4, hull_folder=tmp_path)
    assert (row["made"], row["balanced"]) == (4, 4), row


@pytest.mark.slow
def test_ten_tubes_with_many_hulls_come_to_rest(tmp_path):
    """The tubes do not come to rest if the engine groups contacts into clusters."""
    (row,) = dropped("tube", counts=(10,), seeds=1, hull_folder=tmp_path)
    assert row["made"] == row["asked"] == 1, row


@pytest.mark.slow
def test_difficult_families_of_parts_come_to_rest(tmp_path):
    names = ("socket_screw", "rivet", "tube", "o_ring", "spring", "chain", "shaft", "gear")
    rows = dropped(*names, counts=(1, 10), seeds=2, hull_folder=tmp_path)
    assert len(rows) == 2 * len(names)
    for row in rows:
        assert row["made"] == row["asked"] and row["overlap_mm"] <= 0.5, row
        assert row["balanced"] >= 1, row


def test_a_row_summarises_its_drops():
    drops = [
        {"cpu_s": 1.0, "attempts": 1, "overlap_mm": 0.1, "moved_mm": 0.2},
        {"cpu_s": 9.0},
        {"cpu_s": 2.0, "attempts": 3, "overlap_mm": 0.3, "moved_mm": 1.1},
        {"cpu_s": 4.0, "attempts": 2, "overlap_mm": 0.2, "moved_mm": 0.9},
    ]
    assert zoo._row("nut", 5, drops) == {
        "family": "nut", "count": 5, "made": 3, "asked": 4, "attempts": 2, "most": 3,
        "overlap_mm": 0.3, "cpu_s": 3.0, "cpu_most_s": 9.0, "balanced": 2,
        "moved_median_mm": 0.9, "moved_most_mm": 1.1,
    }  # fmt: skip
    assert zoo._row("nut", 5, drops[1:2]) == {
        "family": "nut", "count": 5, "made": 0, "asked": 1, "cpu_s": 9.0, "cpu_most_s": 9.0
    }  # fmt: skip


def test_a_family_that_is_not_in_the_zoo_is_named():
    with pytest.raises(ValueError, match=r"unicorn.*hex_bolt"):
        dropped("nut", "unicorn", counts=(1,), seeds=1, hull_folder=None)
    assert len(set(ZOO)) == len(ZOO) >= 20
