"""The page of picks: positions of bodies, and refused input."""

import base64
import json
import shutil
import zlib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from graycast.base.errors import GraycastError
from graycast.base.frames import inverse, rigid
from graycast.cli.command import main
from graycast.robot.pick import Outcome, read_episodes
from graycast.robot.pick.results.replay import open_replay, read_motions
from graycast.robot.pick.tool.tools import T_flange_tip
from graycast.show.report.page.walls import open_bin
from graycast.show.report.picks import write_pick_report
from graycast.show.report.picks.bodies import packed_places
from graycast.show.report.picks.words import outcome_words

from .picked import FROM_GRIP_TO_PART, GRIP, LOST_S, STEP_S, STEPS, T_world_part, write_picks


@pytest.fixture(scope="module")
def picks(robots, tmp_path_factory):
    folder = tmp_path_factory.mktemp("picks")
    return write_picks(folder)[0]


@pytest.fixture(scope="module")
def replay(picks):
    return open_replay(picks, folder=picks.parent)


@pytest.fixture(scope="module")
def motions(replay, picks):
    return read_motions(replay, read_episodes(picks)[0])


@pytest.fixture
def copied(picks, tmp_path):
    """Copy the picks with the files of their cell."""
    return shutil.copytree(picks.parent, tmp_path / "cell") / "picks"


def script(path):
    text = path.read_text()
    return json.loads(text[text.index("{") : text.rindex("}") + 1])


def unpacked(text, kind="<f4"):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind)


def test_the_links_of_the_robot_have_the_poses_of_its_kinematics(replay, motions):
    """Law: the last link's pose relative to the flange is constant, as in the URDF."""
    motion, robot = motions[0], replay.robot
    assert motion.T_world_limb.shape[:2] == (STEPS, len(replay.limbs))
    q = json.loads((replay.folder / "bins/000000/motion.json").read_text())["attempts"][0]["q"]
    for i in (0, GRIP, STEPS - 1):
        T = replay.cell.T_world_base @ robot.flange(np.array(q[i]))
        to_flange = inverse(motion.T_world_limb[i, motion.carrier]) @ T
        np.testing.assert_allclose(to_flange, rigid(np.eye(3), np.array([0, 0, 0.0996])), atol=1e-9)
        tip = motion.T_world_limb[i, -1]  # The cup's frame is the tip's frame.
        np.testing.assert_allclose(tip, T @ T_flange_tip(replay.cell.config.tool), atol=1e-9)


@pytest.mark.slow
def test_picks_of_several_folders_are_counted_and_compared(picks, capsys, tmp_path):
    """Counted by hand: of four grips in two bins, two removed a part and two lost the part."""
    other = shutil.copytree(picks, tmp_path / "other")
    plot = tmp_path / "runs.png"
    assert main(["robot", "summary", str(picks), str(other), "--out", str(plot)]) == 0
    text = capsys.readouterr().out
    assert "2 of 4 grips took a part out: 50.0%" in text
    assert "2 bins, 0 cleared; of 4 parts 2 taken, " in text
    assert str(other) in text and f"{plot}: a row for each of 2 folders" in text
    with Image.open(plot) as picture:
        assert picture.height > 200


def test_a_carried_part_keeps_its_pose_in_the_tool(replay, motions, picks):
    """Law: the relative pose of tool and part is constant."""
    motion = motions[0]
    before = np.array(read_episodes(picks)[0].attempts[0]["T_world_part"][0])
    assert T_world_part(motion, GRIP - 1, before) is None
    for i in range(GRIP, STEPS):
        to_part = inverse(motion.T_world_limb[i, -1]) @ T_world_part(motion, i, before)
        np.testing.assert_allclose(to_part, FROM_GRIP_TO_PART, atol=1e-4)  # Angles have 5 digits.
    assert motion.held_until_s == pytest.approx(STEP_S * (STEPS - 1))


def test_a_lost_part_is_released_at_the_time_of_its_loss(motions):
    motion = motions[1]
    assert motion.grip == GRIP
    assert motion.held_until_s == pytest.approx(STEP_S * GRIP + LOST_S)
    last = GRIP + round(LOST_S / STEP_S)
    assert T_world_part(motion, last, np.eye(4)) is not None
    assert T_world_part(motion, last + 1, np.eye(4)) is None
    assert motions[2] is None


def test_packed_poses_are_unpacked_to_the_same_poses(motions):
    """Oracle: SciPy converts the quaternions; no quaternion changes its sign between two times."""
    T = motions[0].T_world_limb
    places = unpacked(packed_places(T)).reshape(*T.shape[:2], 7)
    np.testing.assert_allclose(places[..., :3], 1e3 * T[..., :3, 3], atol=1e-3)
    turn = Rotation.from_quat(places[..., 3:].reshape(-1, 4)).as_matrix()
    np.testing.assert_allclose(turn, T[..., :3, :3].reshape(-1, 3, 3), atol=1e-6)
    assert ((places[1:, :, 3:] * places[:-1, :, 3:]).sum(axis=-1) > 0.9).all()


def test_quaternions_over_a_full_rotation_have_no_jump():
    """A full rotation about any axis passes the point at which a quaternion changes its sign."""
    angles = np.linspace(0, 4 * np.pi, 200)
    T = np.stack([rigid(Rotation.from_rotvec([0, a, 0]).as_matrix(), np.zeros(3)) for a in angles])
    places = unpacked(packed_places(T[:, None])).reshape(-1, 7)
    assert ((places[1:, 3:] * places[:-1, 3:]).sum(axis=-1) > 0.99).all()


def test_the_inside_of_the_bin_is_visible_from_every_side(replay):
    """Only the inner sides and the rim of the bin are drawn; no face points outwards."""
    mesh = open_bin(replay.cell.box)
    corner = mesh.vertices_m[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    middle = corner.mean(axis=1)
    side = np.abs(normal[:, 2]) < 0.5
    assert (np.einsum("fi,fi->f", normal[side], -middle[side]) > 0).all() and side.sum() == 8
    assert (normal[~side][:, 2] > 0.5).all()


def test_every_outcome_has_its_own_colour_and_meaning():
    words = outcome_words()
    assert {one["name"] for one in words} == {str(outcome) for outcome in Outcome}
    for key in ("color", "meaning"):
        assert len({one[key] for one in words}) == len(words)


@pytest.mark.slow
def test_the_page_has_all_bins_and_only_changed_ones_are_built_again(copied, tmp_path):
    folder = {"cell_folder": copied.parent, "width_px": 100}
    done = write_pick_report(copied, tmp_path / "page", **folder)
    again = write_pick_report(copied, tmp_path / "page", **folder)
    assert (done.built, again.built, again.current) == (2, 0, 2)
    index = script(tmp_path / "page/index.js")
    assert [one["id"] for one in index["bins"]] == [0, 2]
    assert index["summary"]["outcomes"] == {"picked": 2, "lost seal": 2, "nothing found": 2}
    record = script(tmp_path / "page/scenes/bin-000002/scene.js")
    assert [one["present"] for one in record["attempts"]] == [[0, 1], [1], [1]]
    scan = script(tmp_path / "page/scenes/bin-000002/attempt-002.js")
    assert (scan["stride"], scan["width"], scan["motion"]["time_s"]) == (2, 80, [0.0])
    thumb = np.array(Image.open(tmp_path / "page/scenes/bin-000002/thumb.jpg"))
    assert thumb.shape == (120, 160, 3) and np.abs(thumb - 60.0).max() <= 2  # the first picture
    shutil.rmtree(copied / "bins/000000")
    work = copied / "bins/000002/work.json"
    work.write_text(work.read_text() + "\n")
    last = write_pick_report(copied, tmp_path / "page", **folder)
    assert (last.built, last.removed) == (1, 1)


def damaged(name, text):
    def act(picks):
        (picks / name).write_text(text)

    return act


def without_bins(picks):
    for entry in (picks / "bins").iterdir():
        shutil.rmtree(entry)


def grip_elsewhere(picks):
    path = picks / "bins/000000/episode.json"
    record = json.loads(path.read_text())
    record["attempts"][0]["T_world_tool"][0][3] += 0.01
    path.write_text(json.dumps(record))


def other_part(picks):
    trimesh.creation.box((60, 40, 31)).export(picks.parent / "box.stl")


def cut_image(name):
    def act(picks):
        path = picks / "bins/000000" / name
        path.write_bytes(path.read_bytes()[:60])

    return act


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (without_bins, "no bin is finished yet: run graycast robot pick first"),
        (damaged("bins/000000/episode.json", "{"), "000000: cannot be read"),
        (damaged("bins/000000/motion.json", '{"attempts": []}'), "motion.json: cannot be read"),
        (damaged("bins/000000/motion.json", "[1, 2"), "motion.json: cannot be read"),
        (damaged("picks.json", "{}"), "picks.json: cannot be read"),
        (other_part, "box.stl has changed"),
        (grip_elsewhere, "mm away from its grip"),
        (cut_image("depth/001.png"), "depth/001.png: cannot be read"),
        (cut_image("pictures/002.png"), "pictures/002.png: cannot be read"),
    ],
)
def test_damaged_picks_are_reported_in_one_line(copied, tmp_path, capfd, damage, message):
    damage(copied)
    options = ["--out", str(tmp_path / "page"), "--files", str(copied.parent)]
    assert main(["robot", "report", str(copied), *options]) == 1
    output = capfd.readouterr().err.strip()
    assert message in output and len(output.splitlines()) == 1, output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["report", "{picks}", "--out", "{out}"], "holds picks: use graycast robot report"),
        (
            ["robot", "report", "{picks}", "--out", "{picks}"],
            "is the dataset itself: give another folder for the page",
        ),
        (["robot", "report", "{out}", "--out", "{out}/page"], "holds no picks"),
        (
            ["robot", "report", "{picks}", "--out", "{out}", "--files", "/nowhere"],
            "give the folder in which their paths begin with --files",
        ),
    ],
)
def test_a_wrong_option_is_reported_in_one_line(picks, tmp_path, capfd, words, message):
    arguments = [word.format(picks=picks, out=tmp_path / "out") for word in words]
    if arguments[0] == "robot" and "--files" not in arguments:
        arguments += ["--files", str(picks.parent)]
    assert main(arguments) == 1
    output = capfd.readouterr().err.strip()
    assert message in output and len(output.splitlines()) == 1, output


def test_the_kind_of_each_part_is_required_in_a_mixed_cell(replay, picks):
    episode = replace(read_episodes(picks)[0], kinds=())
    assert replay.kinds(episode) == (0, 0)  # The cell has only one kind.
    scene = replay.cell.cell.scene
    two = replace(scene, parts=(*scene.parts, replace(scene.parts[0], name="other")))
    mixed = replace(replay, cell=replace(replay.cell, cell=replace(replay.cell.cell, scene=two)))
    with pytest.raises(GraycastError, match="does not state the kind of each part: remove"):
        mixed.kinds(episode)
    assert mixed.kinds(replace(episode, kinds=(1, 0))) == (1, 0)
