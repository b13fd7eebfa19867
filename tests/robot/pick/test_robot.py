"""Arms: poses in closed form, inverse kinematics, limits, and collisions."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")

import coal

from graycast.base.errors import ConfigError
from graycast.base.frames import axis_rotation, rigid
from graycast.robot.pick.arm.arms import ARMS, URDF
from graycast.robot.pick.arm.robot import Obstacle, open_robot

UR5E = (URDF / "ur5e.urdf").read_text(encoding="utf-8")


@pytest.fixture(scope="module", params=list(ARMS))
def robot(request, tmp_path_factory):
    return open_robot(request.param, folder=tmp_path_factory.mktemp("none"))


def dh(d, a, alpha, q):
    """Return a joint's transform from its Denavit-Hartenberg parameters."""
    turn = rigid(axis_rotation("z", q), np.array([0.0, 0.0, d]))
    return turn @ rigid(axis_rotation("x", alpha), np.array([a, 0.0, 0.0]))


def test_the_ur5e_agrees_with_its_maker_s_table(tmp_path):
    """Oracle: the product of the six transforms in the published table."""
    ur = open_robot("ur5e", folder=tmp_path)
    table = [
        (0.1625, 0.0, np.pi / 2), (0.0, -0.425, 0.0), (0.0, -0.3922, 0.0),
        (0.1333, 0.0, np.pi / 2), (0.0997, 0.0, -np.pi / 2), (0.0996, 0.0, 0.0),
    ]  # fmt: skip
    rng = np.random.default_rng(0)
    for q in rng.uniform(-3, 3, (20, 6)):
        T = np.eye(4)
        for (d, a, alpha), angle in zip(table, q, strict=True):
            T = T @ dh(d, a, alpha, angle)
        np.testing.assert_allclose(ur.flange(q), T, atol=1e-12)


def test_a_stretched_diana_is_upright_with_its_flange_facing_down(tmp_path):
    T = open_robot("diana7", folder=tmp_path).flange(np.zeros(7))
    # The lengths between the joints add up; the last joint is next to the arm and points down.
    assert T[2, 3] == pytest.approx(0.2856 + 0.4586 + 0.47702 - 0.0216 - 0.1169)
    np.testing.assert_allclose(T[:3, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(T[:2, 3], [0.065 - 0.0528 - 0.0122 + 0.087, 0], atol=1e-12)


def test_a_diana_is_the_product_of_the_published_origins_of_its_joints(tmp_path):
    """Oracle: the table in the paper, in which each joint is rotated about x from the last."""
    diana = open_robot("diana7", folder=tmp_path)
    table = [
        (0, (0, 0, 0.2856)), (-1, (0, 0, 0)), (1, (0, -0.4586, 0)), (-1, (0.065, 0, 0)),
        (1, (-0.0528, -0.47702, 0)), (-1, (-0.0122, 0, -0.0216)), (-1, (0.087, 0.1169, 0)),
    ]  # fmt: skip
    for q in np.random.default_rng(0).uniform(diana.low, diana.high, (20, 7)):
        T = np.eye(4)
        for (quarters, origin_m), angle in zip(table, q, strict=True):
            T = T @ rigid(axis_rotation("x", quarters * np.pi / 2), np.array(origin_m, float))
            T = T @ rigid(axis_rotation("z", angle), np.zeros(3))
        np.testing.assert_allclose(diana.flange(q), T, atol=1e-12)
    side, turn = 3.12, np.pi / 2
    np.testing.assert_array_equal(diana.high, [side, turn, side, 3.05, side, side, side])
    np.testing.assert_array_equal(diana.low, [-side, -turn, -side, 0, -side, -side, -side])


@pytest.mark.parametrize("name", ARMS)
def test_each_link_of_a_built_in_arm_is_a_capsule(name):
    """Law: the ends of the cylinder are the centres of two spheres with the same radius."""
    for link in ElementTree.parse(URDF / f"{name}.urdf").getroot().findall("link")[:-1]:
        start, end, tube = link.findall("collision")
        place = [np.array(one.find("origin").get("xyz").split(), float) for one in (start, end)]
        radii = {one.find("geometry")[0].get("radius") for one in (start, end, tube)}
        middle, rpy = (np.array(tube.find("origin").get(k).split(), float) for k in ("xyz", "rpy"))
        along = axis_rotation("z", rpy[2]) @ axis_rotation("y", rpy[1]) @ [0.0, 0.0, 1.0]
        half = float(tube.find("geometry/cylinder").get("length")) / 2 * along
        assert len(radii) == 1 and rpy[0] == 0
        np.testing.assert_allclose([middle - half, middle + half], place, atol=1e-12)


@pytest.mark.slow
def test_inverse_kinematics_finds_angles_for_every_pose_of_the_arm(robot):
    rng = np.random.default_rng(1)
    inner = 0.9
    solved = 0
    for _ in range(20):
        q = rng.uniform(inner * robot.low, inner * robot.high)
        T = robot.flange(q)
        back = robot.reach(T, robot.home, seed=0)
        solved += bool(back)
        for each in back:
            assert ((each >= robot.low) & (each <= robot.high)).all()
            np.testing.assert_allclose(robot.flange(each)[:3, 3], T[:3, 3], atol=3e-5)
            np.testing.assert_allclose(robot.flange(each)[:3, :3], T[:3, :3], atol=3e-4)
    assert solved >= 18


def test_a_pose_out_of_reach_has_no_joint_angles(robot):
    far = rigid(np.eye(3), np.array([1.6, 0.0, 0.3]))
    assert robot.reach(far, robot.home, seed=0) == []


def test_the_nearest_of_several_solutions_is_used(robot):
    q = robot.home + 0.05
    back, *others = robot.reach(robot.flange(q), robot.home, seed=0)
    assert np.abs(back - robot.home).max() < 0.5
    away = [np.abs(other - robot.home).max() for other in others]
    assert away == sorted(away)


def box(name, size, at, *, carries=False):
    T = rigid(np.eye(3), np.array(at, float))
    return Obstacle(name=name, shape=coal.Box(*size), T_base_shape=T, carries=carries)


def test_an_arm_collides_only_with_objects_at_its_flange(robot):
    assert robot.touches(robot.home, []) is None
    T = robot.flange(robot.home)
    there = T[:3, 3] - 0.03 * T[:3, 2]
    assert robot.touches(robot.home, [box("crate", (0.02, 0.02, 0.02), there)]) == "crate"
    above = there + np.array([0.0, 0.0, 0.6])
    assert robot.touches(robot.home, [box("crate", (0.02, 0.02, 0.02), above)]) is None
    size, at = (2.0, 2.0, 0.1), [0, 0, -0.05]
    assert robot.touches(robot.home, [box("table", size, at, carries=True)]) is None
    assert robot.touches(robot.home, [box("bin", size, at)]) == "bin"


def test_a_self_collision_of_the_arm_is_detected(tmp_path):
    ur = open_robot("ur5e", folder=tmp_path)
    folded = np.array([0.0, -1.57, 3.1, 0.0, 0.0, 0.0])
    assert ur.touches(folded, []) == "itself"


def test_a_robot_without_a_joint_that_moves_is_refused(tmp_path):
    joint = '<joint name="j" type="fixed"><parent link="base"/><child link="flange"/></joint>'
    text = f'<robot name="a"><link name="base"/><link name="flange"/>{joint}</robot>'
    (tmp_path / "fixed.urdf").write_text(text)
    with pytest.raises(ConfigError, match=r"fixed\.urdf: no joint can move"):
        open_robot("fixed.urdf", folder=tmp_path)


def test_a_robot_is_read_from_a_urdf_file(tmp_path):
    (tmp_path / "arm.urdf").write_text(UR5E)
    mine = open_robot("arm.urdf", folder=tmp_path, home=ARMS["ur5e"])
    own = open_robot("ur5e", folder=tmp_path)
    q = own.home + 0.3
    np.testing.assert_allclose(mine.flange(q), own.flange(q), atol=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "the robot 'arm.urdf' is not known: choose one of ur5e, diana7"),
        ("<robot", "arm.urdf"),
        (UR5E.replace("flange", "hand"), "no link called flange"),
        (
            UR5E.replace('"revolute"', '"continuous"', 1),
            "joint1 is a continuous joint, which is not supported: give it the type revolute",
        ),
        (
            re.sub('velocity="[^"]*"', 'velocity="0"', UR5E, count=1),
            "joint1 has no speed limit: give its limit a velocity greater than 0",
        ),
        (
            re.sub(' velocity="[^"]*"', "", UR5E, count=1),
            "the limit of joint joint1 has no velocity: write it as an attribute of <limit>, in ra",
        ),
        (
            re.sub(' effort="[^"]*"', "", UR5E, count=1),
            "the limit of joint joint1 has no effort: write it",
        ),
        (
            re.sub("<limit [^>]*>", "", UR5E, count=1),
            "joint1 has no lower, no upper, no velocity, no effort: write it as",
        ),
        (
            re.sub("<sphere [^>]*>", '<mesh filename="gone.stl" />', UR5E, count=1),
            "gone.stl could not be found",
        ),
    ],
)
def test_a_wrong_robot_is_refused_in_one_line(tmp_path, content, message):
    if content is not None:
        (tmp_path / "arm.urdf").write_text(content)
    with pytest.raises(ConfigError, match=message) as error:
        open_robot("arm.urdf", folder=tmp_path)
    assert "\n" not in str(error.value)


def test_an_impossible_home_pose_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="home has 2 angles, and the robot has 6 joints"):
        open_robot("ur5e", folder=tmp_path, home=[0, 0])
    with pytest.raises(ConfigError, match=r"home of joint 4 is -0.500 rad; its limits are 0.000"):
        open_robot("diana7", folder=tmp_path, home=[0, 0, 0, -0.5, 0, 0, 0])
