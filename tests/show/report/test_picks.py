"""Picks as a page and a film: where things are said to be, and what is refused."""

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
from graycast.base.frames import inverse, rigid, transform_points
from graycast.cli.command import main
from graycast.rig.optics import project
from graycast.robot.pick import Outcome, read_episodes
from graycast.robot.pick.replay import open_replay, read_motions
from graycast.robot.pick.tools import T_flange_tip
from graycast.show.report.picks import film, write_film, write_pick_report
from graycast.show.report.picks.bodies import look, open_bin, packed_places
from graycast.show.report.picks.words import OUTCOME_COLOR, outcome_words

from .picked import FROM_GRIP_TO_PART, GRIP, LOST_S, STEP_S, STEPS, depth, write_picks


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
    """With the cell's own files beside it."""
    return shutil.copytree(picks.parent, tmp_path / "cell") / "picks"


def script(path):
    text = path.read_text()
    return json.loads(text[text.index("{") : text.rindex("}") + 1])


def unpacked(text, kind="<f4"):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind)


def test_limbs_are_where_the_robot_has_them(replay, motions):
    """Law: the last limb of the arm stands to the flange as the URDF says, at every time."""
    motion, robot = motions[0], replay.robot
    assert motion.T_world_limb.shape[:2] == (STEPS, len(replay.limbs))
    q = json.loads((replay.folder / "bins/000000/motion.json").read_text())["attempts"][0]["q"]
    for i in (0, GRIP, STEPS - 1):
        T = replay.cell.T_world_base @ robot.flange(np.array(q[i]))
        to_flange = inverse(motion.T_world_limb[i, motion.carrier]) @ T
        np.testing.assert_allclose(to_flange, rigid(np.eye(3), np.array([0, 0, 0.0996])), atol=1e-9)
        tip = motion.T_world_limb[i, -1]  # the cup's frame is the tip's
        np.testing.assert_allclose(tip, T @ T_flange_tip(replay.cell.config.tool), atol=1e-9)


def test_folders_of_picks_are_counted_and_compared(picks, capsys, tmp_path):
    """By hand: of four grips in two bins two took a part out, the other two lost it."""
    other = shutil.copytree(picks, tmp_path / "other")
    plot = tmp_path / "runs.png"
    assert main(["robot", "summary", str(picks), str(other), "--out", str(plot)]) == 0
    text = capsys.readouterr().out
    assert "2 of 4 grips took a part out: 50.0%" in text
    assert "2 bins, 0 cleared; of 4 parts 2 taken, " in text
    assert str(other) in text and f"{plot}: a row for each of 2 folders" in text
    with Image.open(plot) as picture:
        assert picture.height > 200


def test_a_part_stands_still_to_the_tool_that_carries_it(replay, motions, picks):
    """Law: the tool's frame and the part's keep their places to each other."""
    motion = motions[0]
    before = np.array(read_episodes(picks)[0].attempts[0]["T_world_part"][0])
    assert motion.T_world_part(GRIP - 1, before) is None
    for i in range(GRIP, STEPS):
        to_part = inverse(motion.T_world_limb[i, -1]) @ motion.T_world_part(i, before)
        np.testing.assert_allclose(to_part, FROM_GRIP_TO_PART, atol=1e-4)  # angles: 5 digits
    assert motion.held_until_s == pytest.approx(STEP_S * (STEPS - 1))


def test_a_part_that_was_lost_is_let_go_then(motions):
    motion = motions[1]
    assert motion.grip == GRIP
    assert motion.held_until_s == pytest.approx(STEP_S * GRIP + LOST_S)
    last = GRIP + round(LOST_S / STEP_S)
    assert motion.T_world_part(last, np.eye(4)) is not None
    assert motion.T_world_part(last + 1, np.eye(4)) is None
    assert motions[2] is None


def test_packed_places_come_back(motions):
    """Oracle: SciPy turns the quaternions back; between two times none changes its sign."""
    T = motions[0].T_world_limb
    places = unpacked(packed_places(T)).reshape(*T.shape[:2], 7)
    np.testing.assert_allclose(places[..., :3], 1e3 * T[..., :3, 3], atol=1e-3)
    turn = Rotation.from_quat(places[..., 3:].reshape(-1, 4)).as_matrix()
    np.testing.assert_allclose(turn, T[..., :3, :3].reshape(-1, 3, 3), atol=1e-6)
    assert ((places[1:, :, 3:] * places[:-1, :, 3:]).sum(axis=-1) > 0.9).all()


def test_a_turn_all_the_way_round_keeps_its_quaternions_together():
    """About any axis a whole turn passes through the quaternion's change of sign."""
    angles = np.linspace(0, 4 * np.pi, 200)
    T = np.stack([rigid(Rotation.from_rotvec([0, a, 0]).as_matrix(), np.zeros(3)) for a in angles])
    places = unpacked(packed_places(T[:, None])).reshape(-1, 7)
    assert ((places[1:, 3:] * places[:-1, 3:]).sum(axis=-1) > 0.99).all()


def test_one_looks_into_the_bin_from_every_side(replay):
    """What is left of the bin is its inside and its rim: nothing of it faces out."""
    mesh = open_bin(replay)
    corner = mesh.vertices_m[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    middle = corner.mean(axis=1)
    side = np.abs(normal[:, 2]) < 0.5
    assert (np.einsum("fi,fi->f", normal[side], -middle[side]) > 0).all() and side.sum() == 8
    assert (normal[~side][:, 2] > 0.5).all()


def test_every_outcome_has_a_colour_and_a_meaning_of_its_own():
    words = outcome_words()
    assert {one["name"] for one in words} == {str(outcome) for outcome in Outcome}
    for key in ("color", "meaning"):
        assert len({one[key] for one in words}) == len(words)


def test_the_page_holds_the_bins_and_is_made_anew_where_they_change(copied, tmp_path):
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
    shutil.rmtree(copied / "bins/000000")
    work = copied / "bins/000002/work.json"
    work.write_text(work.read_text() + "\n")
    last = write_pick_report(copied, tmp_path / "page", **folder)
    assert (last.built, last.removed) == (1, 1)


def test_the_film_lasts_as_long_as_the_motion(picks, tmp_path):
    """Law: the pictures' times add up to the motions, at the speed asked for, and the outcomes."""
    count = write_film(
        picks, 0, tmp_path / "bin.gif", cell_folder=picks.parent, speed=12.0, width_px=280
    )
    moving_s = 2 * STEP_S * (STEPS - 1) / 12.0
    with Image.open(tmp_path / "bin.gif") as gif:
        assert gif.size == (280, 210 + 26)
        lasts_ms, inks = 0, set()
        for k in range(gif.n_frames):
            gif.seek(k)
            lasts_ms += gif.info["duration"]
            inks |= {ink for _, ink in gif.convert("RGB").getcolors(10_000)}
    wanted = {OUTCOME_COLOR[name] for name in ("picked", "lost seal", "nothing found")}
    for ink in wanted:  # the palette may have a grey beside a grey
        off = np.abs(np.array(list(inks)) - list(bytes.fromhex(ink[1:]))).max(axis=1)
        assert off.min() <= 4
    ends_ms = film.FRAME_MS * (3 * 8 + 3)  # each attempt's outcome, and its last picture
    assert lasts_ms == count * film.FRAME_MS
    assert abs(lasts_ms - 1e3 * moving_s - ends_ms) <= 2 * film.FRAME_MS


def test_the_film_shows_the_arm_where_the_camera_model_puts_it(replay, motions):
    """Oracle: the pinhole projection of the joints; beside the robot there is the sky."""
    eye = film._eye(replay, 240)
    for i in (0, GRIP, STEPS - 1):
        layer = film._robot(replay, eye, motions[0].T_world_limb[i])
        visible = np.isfinite(layer.z)
        joints = motions[0].T_world_limb[i, [1, 2, 3, 4], :3, 3]
        at = np.rint(project(eye.camera, transform_points(inverse(eye.T_world_eye), joints)))
        assert all(visible[int(v), int(u)] for u, v in at)
        assert 0.01 < visible.mean() < 0.2
        assert not visible[[0, 0, -1, -1], [0, -1, 0, -1]].any()


def test_the_film_looks_down_into_the_bin_with_what_is_high_on_top(replay):
    eye = film._eye(replay, 240)
    line = np.array([1.0, 1.0, 0.0]) * 1e-3 * np.array(look(replay)["middle"])
    line = line + np.array([[0.0, 0.0, z] for z in (0.0, 0.2, 0.4)])
    at = project(eye.camera, transform_points(inverse(eye.T_world_eye), line))
    assert (np.diff(at[:, 1]) < -5).all() and np.ptp(at[:, 0]) < 1e-6
    rim_m = replay.cell.cell.scene.bin.bounds_m[1, 2]
    assert eye.T_world_eye[2, 3] > rim_m + 0.2
    base = transform_points(inverse(eye.T_world_eye), replay.cell.T_world_base[None, :3, 3])
    middle = transform_points(inverse(eye.T_world_eye), np.zeros((1, 3)))
    assert base[0, 2] > middle[0, 2]  # the robot stands behind the bin


def test_the_film_leaves_the_points_of_a_carried_part_out_and_no_others(replay, picks):
    """Oracle: the scan of the heap that is left, which the picks made by hand have next."""
    episode = read_episodes(picks)[0]
    step = film._scan_steps(replay, episode, 0)
    left = film._without(replay, step, (0, 0), episode.attempts[0], 0)
    gone = (step > 0) & (left == 0)
    behind_m = depth(replay.cell, np.array(episode.attempts[0]["T_world_part"])[1:])
    nearer = behind_m - step * film.DEPTH_STEP_M > 0.01  # more than a centimetre stood on it
    assert gone[nearer].all() and nearer.sum() > 50
    far = np.abs(behind_m - step * film.DEPTH_STEP_M) < 1e-3
    assert not gone[far].any() and far.sum() > 1000


def test_what_is_left_at_the_end_is_shown_where_it_truly_lies(replay, picks):
    """One part is left, and nothing was found: the ghost is at the projection of its middle."""
    attempt = read_episodes(picks)[0].attempts[-1]
    rest = film._remaining(attempt, None)
    assert list(rest) == [1]
    eye = film._eye(replay, 240)
    ground = film._ground(replay, eye)
    layer = film._with_ghosts(ground, replay, eye, (0, 0), rest)
    changed = (layer.color != ground.color).any(axis=-1)
    middle = transform_points(inverse(eye.T_world_eye), rest[1][None, :3, 3])
    (u, v) = np.rint(project(eye.camera, middle)[0]).astype(int)
    assert changed[v, u] and 5 < changed.sum() < 400
    rows, columns = np.nonzero(changed)
    assert np.hypot(rows.mean() - v, columns.mean() - u) < 4


def test_the_tool_stays_in_the_film_s_picture(replay, motions):
    """Of a motion that leaves the eye's usual picture; every vertex of the tool is looked at."""
    away = replace(motions[0], T_world_limb=motions[0].T_world_limb.copy())
    away.T_world_limb[:, :, 2, 3] += np.linspace(0, 0.6, STEPS)[:, None]
    outside = []
    for eye in (film._eye(replay, 240), film._eye(replay, 240, [None, away])):
        end = zip(replay.limbs, away.T_world_limb[-1], strict=True)
        tool = np.vstack([transform_points(T, m.vertices_m) for m, T in end][replay.arm_limbs :])
        u, v = project(eye.camera, transform_points(inverse(eye.T_world_eye), tool)).T
        outside.append(not ((u > -1) & (u < 240) & (v > -1) & (v < 180)).all())
    assert outside == [True, False]


def test_nearer_things_hide_farther_ones(replay):
    near = film._Layer(color=np.full((1, 2, 3), 0.2), z=np.array([[1.0, np.inf]]))
    far = film._Layer(color=np.full((1, 2, 3), 0.8), z=np.array([[2.0, np.inf]]))
    for both in (near.over(far), far.over(near)):
        assert both.z[0, 0] == 1.0 and (both.color[0, 0] == 0.2).all()
    assert (near.over(far).color[0, 1] == 0.8).all()  # nothing hides nothing


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
def test_damaged_picks_are_told_in_one_line(copied, tmp_path, capfd, damage, message):
    damage(copied)
    options = ["--out", str(tmp_path / "page"), "--files", str(copied.parent)]
    assert main(["robot", "report", str(copied), *options]) == 1
    output = capfd.readouterr().err.strip()
    assert message in output and len(output.splitlines()) == 1, output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["robot", "film", "{picks}", "--out", "{out}.gif", "--bin", "1"],
            "bin 1 does not exist: it has 0 to 2",
        ),
        (["robot", "film", "{picks}", "--out", "{out}.mp4"], "ends with .gif or .webp"),
        (["robot", "film", "{picks}", "--out", "{out}.gif", "--width", "100"], "at least 280"),
        (["report", "{picks}", "--out", "{out}"], "holds picks: use graycast robot report"),
        (
            ["robot", "report", "{picks}", "--out", "{picks}"],
            "is the dataset itself: give another folder for the page",
        ),
        (["robot", "film", "{out}", "--out", "{out}.gif"], "holds no picks"),
        (
            ["robot", "report", "{picks}", "--out", "{out}", "--files", "/nowhere"],
            "give the folder in which their paths begin with --files",
        ),
    ],
)
def test_a_wrong_wish_is_told_in_one_line(picks, tmp_path, capfd, words, message):
    arguments = [word.format(picks=picks, out=tmp_path / "out") for word in words]
    if arguments[0] == "robot" and "--files" not in arguments:
        arguments += ["--files", str(picks.parent)]
    assert main(arguments) == 1
    output = capfd.readouterr().err.strip()
    assert message in output and len(output.splitlines()) == 1, output


def test_mixed_cells_need_to_know_which_part_is_which(replay, picks):
    episode = replace(read_episodes(picks)[0], kinds=())
    assert replay.kinds(episode) == (0, 0)  # there is only one kind
    scene = replay.cell.cell.scene
    two = replace(scene, parts=(*scene.parts, replace(scene.parts[0], name="other")))
    mixed = replace(replay, cell=replace(replay.cell, cell=replace(replay.cell.cell, scene=two)))
    with pytest.raises(GraycastError, match="does not state the kind of each part: remove"):
        mixed.kinds(episode)
    assert mixed.kinds(replace(episode, kinds=(1, 0))) == (1, 0)
