"""Contacts of a tool with plates, edges, neighbours and wedges, against closed forms."""

import re

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Manifold

from graycast.base.frames import axis_rotation, rigid
from graycast.robot.grasp import Cup, Doubt, Jaws, closing, jaw_places
from graycast.robot.pick.outcome import Outcome
from graycast.robot.pick.tool.contact import NoGrip, PartGrip
from graycast.robot.pick.tool.jaw_tool import JawTool
from graycast.robot.pick.tool.suction_tool import SuctionTool
from graycast.robot.pick.tool.touch import ContactPart, touch
from graycast.world.drop import make_bodies
from graycast.world.parts import Material, Mesh, Part

PLATE_M = (0.08, 0.06, 0.02)
CUP = SuctionTool(cup=Cup(radius_m=0.01, height_m=0.01), stroke_m=0.008, length_m=0.15)
JAWS = JawTool(
    kind="jaws", jaws=Jaws(opening_m=0.05, friction=0.3, finger_m=(0.006, 0.01, 0.04)), length_m=0.1
)


def part_of(mesh):
    mesh = Mesh(vertices_m=np.array(mesh.vertices), faces=np.array(mesh.faces))
    return Part(name="part", mesh=mesh, material=Material(), density_kg_m3=1000.0, friction=0.4)


@pytest.fixture(scope="module")
def plate(robots, tmp_path_factory):
    part = part_of(trimesh.creation.box(PLATE_M))
    folder = tmp_path_factory.mktemp("hulls")
    return ContactPart.of(part, make_bodies([part], hull_folder=folder)[0])


def at(x, y, z):
    return rigid(np.eye(3), np.array([x, y, z], dtype=float))


def down_on(kind, T_tool, poses, tool=CUP):
    return touch(tool, T_tool, [kind], np.stack(poses), np.zeros(len(poses), int))


@pytest.mark.parametrize("off_m", [-0.007, 0.0, 0.007])
def test_a_cup_comes_to_rest_on_the_plate_within_its_stroke(plate, off_m):
    met = down_on(plate, at(0.01, 0, 0.01 + off_m), [at(0, 0, 0)])
    assert isinstance(met, PartGrip) and met.part == 0
    np.testing.assert_allclose(met.T_world_tool[:3, 3], [0.01, 0, 0.01], atol=1e-9)
    np.testing.assert_allclose(met.hold.T_part_tool[:3, 3], [0.01, 0, 0.01], atol=1e-9)


@pytest.mark.parametrize(
    ("z", "outcome"),
    [(0.02, Outcome.MISSED), (0.0, Outcome.COLLISION_UNSEEN)],
)
def test_a_cup_misses_or_pushes_a_plate_beyond_its_stroke(plate, z, outcome):
    assert down_on(plate, at(0, 0, z), [at(0, 0, 0)]).outcome is outcome


def test_a_cup_over_the_edge_of_a_plate_does_not_seal(plate):
    inside = down_on(plate, at(0.04 - 0.0105, 0, 0.01), [at(0, 0, 0)])
    over = down_on(plate, at(0.04 - 0.0085, 0, 0.01), [at(0, 0, 0)])
    assert isinstance(inside, PartGrip)
    assert over.outcome is Outcome.NOT_HELD and "has no surface" in over.detail


def test_a_cup_does_not_seal_on_two_adjacent_plates(plate):
    """The plates touch at the same height, but there is a gap between them."""
    poses = [at(-0.04, 0, 0), at(0.04, 0, 0)]
    assert down_on(plate, at(0.004, 0, 0.01), poses).outcome is Outcome.NOT_HELD
    assert down_on(plate, at(0.02, 0, 0.01), poses).part == 1


def test_a_cup_touches_the_upper_of_two_parts(plate):
    poses = [at(0, 0, 0), at(0, 0, 0.0205)]
    assert down_on(plate, at(0, 0, 0.0305), poses).part == 1


def test_a_neighbour_collides_with_the_tube(plate):
    """The neighbour is 80 mm high and 12 mm from the axis; the radius of the tube is 12 mm."""
    upright = rigid(axis_rotation("y", np.pi / 2), np.array([0.018, 0, 0.04]))
    met = down_on(plate, at(0, 0, 0.01), [at(-0.025, 0, 0), upright])
    assert met.outcome is Outcome.COLLISION_UNSEEN and met.part == 1 and "tube" in met.detail
    away = upright.copy()
    away[0, 3] = 0.024
    assert isinstance(down_on(plate, at(0, 0, 0.01), [at(-0.025, 0, 0), away]), PartGrip)


def test_jaws_that_close_on_a_bar_centre_the_bar(robots):
    bar = part_of(trimesh.creation.box((0.03, 0.06, 0.02)))
    kind = ContactPart.of(bar, make_bodies([bar])[0])
    met = down_on(kind, at(0.003, 0, 0), [at(0, 0, 0)], JAWS)
    assert isinstance(met, PartGrip)
    np.testing.assert_allclose(met.hold.T_part_tool[:3, 3], [0, 0, 0], atol=1e-9)
    assert down_on(kind, at(0, 0, 0.02), [at(0, 0, 0)], JAWS).outcome is Outcome.MISSED
    assert down_on(kind, at(0.02, 0, 0), [at(0, 0, 0)], JAWS).outcome is Outcome.COLLISION_UNSEEN
    beside = [at(-0.012, 0, 0), at(0.02, 0, 0)]
    narrow = part_of(trimesh.creation.box((0.01, 0.06, 0.02)))
    thin = ContactPart.of(narrow, make_bodies([narrow])[0])
    two = down_on(thin, at(0, 0, 0), beside, JAWS)
    assert two.outcome is Outcome.NOT_HELD and "two parts" in two.detail


@pytest.fixture(scope="module")
def flanged(robots, tmp_path_factory):
    """Return a disc of 40 mm with a hub of 20 mm on it; each is 12 mm high."""
    disc = Manifold.cylinder(12, 20, 20, 48) + Manifold.cylinder(24, 10, 10, 48)
    solid = disc.to_mesh64()
    part = part_of(trimesh.Trimesh(1e-3 * solid.vert_properties[:, :3], solid.tri_verts))
    folder = tmp_path_factory.mktemp("hulls")
    return ContactPart.of(part, make_bodies([part], hull_folder=folder)[0])


def test_a_grip_is_lost_if_a_finger_meets_a_flange_before_its_pad_meets_the_hub(flanged):
    """The tips are 1 mm deep in the flange; a tool may push a part aside by more than this."""
    for z, outcome in ((0.017, PartGrip), (0.015, NoGrip)):
        met = touch(
            JAWS, at(0, 0, z), [flanged], np.eye(4)[None], np.zeros(1, int), opening_m=0.020
        )
        assert isinstance(met, outcome), z
    assert met.outcome is Outcome.NOT_HELD
    # The open finger is 2 mm from the hub, whose facets are slightly inclined.
    assert re.fullmatch(r"a finger meets the part 2\.[01] mm before its pad", met.detail)


@pytest.mark.slow
def test_no_grip_with_a_score_of_0_is_held_in_the_simulation(flanged, robots):
    part = flanged.part
    jaws = JAWS.jaws
    doubt = Doubt(position_m=2e-4, angle_rad=2e-3)
    known = {"weight_n": 0.3, "center_m": np.array([0, 0, 0.010]), "doubt": doubt}
    outcomes = {True: [], False: []}
    for grip in jaw_places(part.mesh, jaws, **known, count=12, chances=3):
        met = touch(
            JAWS,
            grip.T_part_tool,
            [flanged],
            np.eye(4)[None],
            np.zeros(1, int),
            opening_m=grip.opening_m,
        )
        outcomes[grip.score > 0].append(isinstance(met, PartGrip))
    assert len(outcomes[False]) >= 20 and not any(outcomes[False])
    assert len(outcomes[True]) >= 8 and np.mean(outcomes[True]) > 0.9


def extruded(outline_m):
    """Return a prism over an outline, 40 mm high along z."""
    # In metres, the lengths would be near the smallest length that the library distinguishes.
    solid = CrossSection([1e3 * np.asarray(outline_m)]).extrude(40.0).to_mesh64()
    return trimesh.Trimesh(1e-3 * solid.vert_properties[:, :3], solid.tri_verts)


@pytest.mark.parametrize("slope", [0.1, 0.25])
def test_the_slope_below_the_pads_equals_that_of_the_wedge(slope):
    """One side of the wedge is vertical, and the other has the slope."""
    low, high = 0.02, 0.02 + slope * 0.04
    outline = np.array([[0, -0.02], [low, -0.02], [high, 0.02], [0, 0.02]])
    part = part_of(extruded(outline))
    aside_m, estimate, _ = closing(part.mesh, Jaws(opening_m=0.06), at(0.01, 0.0, 0.02))
    assert estimate == pytest.approx(slope, rel=1e-6)
    # The pad meets the wedge at its thickest point, 0.95 of the pad's radius above its centre.
    outermost = 0.02 + slope * (0.02 + 0.95 * 0.004)
    assert aside_m == pytest.approx(outermost / 2 - 0.01, abs=1e-9)


def test_surfaces_behind_the_touched_face_do_not_change_the_slope():
    """A block 20 mm thick has a corner cut at 45 degrees below half of a pad."""
    outline = [[0, -0.02], [0.02, -0.02], [0.02, 0.8e-3], [5e-3, 15.8e-3], [0, 15.8e-3]]
    part = part_of(extruded(outline))
    aside_m, slope, _ = closing(part.mesh, Jaws(opening_m=0.06), at(0.01, 0.0, 0.02))
    assert slope == pytest.approx(0, abs=1e-6) and aside_m == pytest.approx(0, abs=1e-9)
    # When the pad is 3 mm farther along, it meets only the cut and slips.
    _, slope, _ = closing(part.mesh, Jaws(opening_m=0.06), at(0.01, 0.006, 0.02))
    assert slope == pytest.approx(1, rel=1e-6)


def test_a_pad_that_touches_no_part_has_no_grip():
    part = part_of(trimesh.creation.box((0.03, 0.06, 0.02)))
    assert closing(part.mesh, Jaws(opening_m=0.06), at(0, 0.04, 0)) is None
