"""Labels of plates against hand calculations, and refused inputs."""

import math

import numpy as np
import pytest
import trimesh

from graycast.base.errors import DatasetError
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.cell.config import Config
from graycast.cell.resolve import file_digests
from graycast.dataset.files.json_text import plain
from graycast.dataset.read.stored import StoredDataset
from graycast.dataset.write.claim import described_values
from graycast.rig.pair import preset_rig
from graycast.robot.grasp import CARRIED_M_S2, Cup, Grip, Jaws
from graycast.robot.grasp_labels import Labelling, stored_world
from graycast.robot.grasp_labels.scene_labels import (
    _half_and_half,
    _label,
    carry_out,
    label_scene,
    straight_up,
)
from graycast.robot.grasp_labels.stored_world import ScenePoses, Stock, around, make_world
from graycast.robot.pick.tool.jaw_tool import JawTool
from graycast.robot.pick.tool.suction_tool import SuctionTool
from graycast.world.drop.lift import STEP_S
from graycast.world.drop.rapier import GRAVITY_M_S2, SKIN_M
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import Bin

SIDES_M = (0.16, 0.06, 0.01)
MASS_KG = 0.5
CUP = Cup(radius_m=0.01, height_m=0.01, vacuum_pa=40e3, friction=0.5)
SUCTION = SuctionTool(cup=CUP, length_m=0.2, tube_m=0.006)
JAWS = JawTool(
    kind="jaws",
    jaws=Jaws(opening_m=0.08, force_n=300.0, finger_m=(0.006, 0.01, 0.05)),
    length_m=0.2,
)


def plate():
    box = trimesh.creation.box(SIDES_M)
    mesh = Mesh(vertices_m=np.array(box.vertices), faces=np.array(box.faces))
    density = MASS_KG / math.prod(SIDES_M)
    return Part(name="plate", mesh=mesh, material=Material(), density_kg_m3=density, friction=0.5)


def world_of(tool, **options):
    stock = Stock(bin=Bin(inner_m=(0.4, 0.3, 0.15)), parts=(plate(),), rig=preset_rig("paper"))
    return make_world(stock, Labelling(tool=tool, places=60, **options))


@pytest.fixture(scope="module")
def suction(robots):
    return world_of(SUCTION)


def test_a_changed_bin_is_refused(tmp_path, monkeypatch):
    """Without this check, the labels of a continued run would belong to two bins."""
    parts = [{"builtin": "toothpaste"}]
    config = Config(rig="paper", parts=parts, bin={"mesh": "bin.stl", "unit": "mm"})
    (tmp_path / "bin.stl").write_text("a bin")
    settings = config.model_dump(mode="json", exclude={"scenes", "seed"})
    claim = {
        "config": settings | {"files": file_digests(config, tmp_path)},
        "distractors": [],
        "parts": [],
        "rig": plain(described_values(preset_rig("paper"))),
    }
    dataset = StoredDataset(
        folder=tmp_path / "out",
        claim=claim,
        categories={},
        scene_ids={"train": ()},
        sizes_px={"": (48, 64)},
        images=(("", 0),),
        holds=frozenset(),
    )
    box = Bin(inner_m=(0.4, 0.3, 0.15))
    monkeypatch.setattr("graycast.cell.stored_bin.resolve_bin", lambda *_: (box, ()))
    monkeypatch.setattr(stored_world, "resolve_parts", lambda *_: ((), ()))
    assert stored_world.read_stock(dataset, tmp_path).bin is box
    (tmp_path / "bin.stl").write_text("another bin")
    with pytest.raises(DatasetError, match=r"the bin's mesh .*bin\.stl has changed since"):
        stored_world.read_stock(dataset, tmp_path)


def heap_of(*T_world_part):
    T_world_cam = rigid(axis_rotation("x", np.pi), np.array([0.0, 0.0, 1.0]))
    poses = np.stack(T_world_part)
    return ScenePoses(
        T_world_cam=T_world_cam,
        T_world_part=poses,
        T_cam_part=inverse(T_world_cam) @ poses,
        part_index=np.zeros(len(poses), dtype=np.int64),
    )


def lying(x=0.0, y=0.0, z=SIDES_M[2] / 2 + SKIN_M):
    return rigid(np.eye(3), np.array([x, y, z]))


def on_top(x=0.0, y=0.0):
    return Grip(T_part_tool=rigid(np.eye(3), np.array([x, y, SIDES_M[2] / 2])), score=1.0)


def ended(world, heap, grip, number=0):
    label = _label(world, heap, around(world, heap), number, grip)
    assert label.reach == "free"
    return carry_out(world, heap, label)


def tilt_limit_m(load_n):
    """Return the distance d at which the load tilts the cup: load d = (pull - load) r / 2."""
    return (CUP.pull_n - load_n) * CUP.radius_m / 2 / load_n


@pytest.mark.slow
def test_a_plate_is_held_at_its_centre_and_lost_beyond_the_tilt_limit(suction):
    """The force at rest is the weight; at the start of the lift, it is 1.5 times the weight."""
    weight_n = MASS_KG * GRAVITY_M_S2
    heap = heap_of(lying())
    centre = ended(suction, heap, on_top())
    assert centre.success
    # This is the load at constant acceleration; the spring exceeds it slightly at the start.
    most_n = (1 + CARRIED_M_S2 / GRAVITY_M_S2) * weight_n
    assert centre.least_factor == pytest.approx(CUP.pull_n / most_n, rel=0.15)
    assert ended(suction, heap, on_top(0.6 * tilt_limit_m(most_n))).success
    lost = ended(suction, heap, on_top(1.1 * tilt_limit_m(weight_n)))
    assert lost.ended == "lost seal" and lost.least_factor < 1


def test_a_cup_over_the_edge_or_over_a_neighbour_s_edge_does_not_seal(suction):
    heap = heap_of(lying())
    assert ended(suction, heap, on_top(SIDES_M[0] / 2 - 0.5 * CUP.radius_m)).ended == "not held"
    above = lying(z=1.5 * SIDES_M[2] + 3 * SKIN_M, y=0.045)
    covered = heap_of(lying(), above)
    assert ended(suction, covered, on_top(y=0.01)).ended == "not held"
    assert ended(suction, covered, on_top(), number=1).success


@pytest.mark.parametrize(("stroke_m", "ending"), [(0.015, "other part"), (0.005, None)])
def test_a_grip_on_a_covered_part_is_labelled_as_a_failure(robots, stroke_m, ending):
    """Another plate of 10 mm covers the plate: the cup touches it within its stroke or collides."""
    world = world_of(SUCTION.model_copy(update={"stroke_m": stroke_m}))
    two = heap_of(lying(), lying(z=1.5 * SIDES_M[2] + 2 * SKIN_M))
    label = _label(world, two, around(world, two), 0, on_top())
    if ending is None:
        assert label.reach == "part"
    else:
        assert label.reach == "free" and carry_out(world, two, label).ended == ending


@pytest.mark.slow
def test_an_unknown_weight_on_a_part_makes_the_cup_lose_the_part(robots):
    """At 25 mm from the centre, the moment is 0.18 Nm of 0.26 Nm; a second plate adds 0.5 Nm."""
    world = world_of(SUCTION.model_copy(update={"cup": Cup(radius_m=0.015, height_m=0.015)}))
    beside = on_top(-0.025)
    assert ended(world, heap_of(lying()), beside).success
    upon = lying(x=0.075, z=1.5 * SIDES_M[2] + 2 * SKIN_M)
    assert ended(world, heap_of(lying(), upon), beside).ended == "lost seal"


@pytest.mark.parametrize(
    ("T", "reach"),
    [
        (rigid(np.eye(3), np.array([0.0, 0.0, 0.2])), "free"),
        (rigid(axis_rotation("y", np.radians(60)), np.array([0.18, 0.0, 0.06])), "bin"),
        (rigid(axis_rotation("x", np.pi), np.array([0.0, 0.0, 0.1])), "table"),
    ],
)
def test_the_object_that_the_tool_collides_with_is_named(suction, T, reach):
    heap = heap_of(T)
    label = _label(suction, heap, around(suction, heap), 0, on_top())
    assert label.reach == reach


@pytest.mark.slow
def test_jaws_hold_an_upright_plate(robots):
    world = world_of(JAWS)
    lean = axis_rotation("x", np.pi / 2)  # The part is on its long edge.
    heap = heap_of(rigid(lean, np.array([0.0, 0.0, SIDES_M[1] / 2 + SKIN_M])))
    labels = label_scene(world, heap, Labelling(tool=JAWS, simulate=6), seed=0, scene_id=0)
    tried = [label for label in labels if label.ending is not None]
    assert len(tried) == 6
    good = [label for label in tried if label.grip.score > 0.9]  # 2 mm clearance are two sigma.
    assert good and all(label.ending.success for label in good)


def test_the_lift_has_its_stated_height_and_acceleration():
    path = straight_up(np.eye(4), 0.2)
    z = path[:, 2, 3]
    assert z[0] == 0 and z[-1] == pytest.approx(0.2, abs=2e-4)
    speed = np.diff(z) / STEP_S
    assert speed.max() == pytest.approx(0.25, rel=1e-6) and speed.min() >= 0
    # In the step in which the acceleration ends, the speed changes less.
    assert np.abs(np.diff(speed)).max() / STEP_S <= CARRIED_M_S2 * (1 + 1e-6)
    assert (path[:, :2, 3] == 0).all()


@pytest.mark.parametrize(
    ("good", "bad", "count", "goods"),
    [
        (9, 9, 6, 3),
        (9, 9, 5, 3),
        (1, 9, 6, 1),
        (9, 2, 6, 4),
        (2, 2, 6, 2),
        (0, 9, 4, 0),
        (9, 0, 4, 4),
    ],
)
def test_half_of_the_selected_grips_have_score_0_if_enough_of_them_exist(good, bad, count, goods):
    scores = [0.5] * good + [0.0] * bad
    indices = _half_and_half(scores, count, np.random.default_rng(0))
    assert len(set(indices)) == len(indices) == min(count, good + bad)
    assert sum(scores[k] > 0 for k in indices) == goods


@pytest.mark.slow
def test_the_same_seed_gives_the_same_labels(suction):
    heap = heap_of(lying(), lying(y=0.08))
    options = Labelling(tool=SUCTION, simulate=4)
    first, second, other = (
        label_scene(suction, heap, options, seed=seed, scene_id=2) for seed in (0, 0, 1)
    )

    def fields(labels):
        return [
            (each.instance, each.grip.T_part_tool.tobytes(), each.reach, each.ending)
            for each in labels
        ]

    assert fields(first) == fields(second) != fields(other)
    assert {label.instance for label in first} == {0, 1}
