"""The command rig hand-eye: scans from the simulator's own pictures, predictions, and refusals."""

import json

import cv2
import numpy as np
import pytest
import yaml
from real.calibrate.test_calibrate import textured_board
from stage import in_camera

from graycast.camera.scanner import preset, take
from graycast.cell.resolve import patterns_of
from graycast.cli.command import main
from graycast.dataset.files.sample import Raw
from graycast.dataset.write.raw import raw_files
from graycast.rendering import Quality
from graycast.rig.optics import rays
from graycast.world.scene import EMPTY_LAYOUT
from studies.hand_eye import BOARD, boards_in_view, cell, error_m

TEXT = "chessboard:9x6:0.025"


def command(capsys, *arguments):
    """Return the exit code, the output and the errors of the command."""
    code = main(["rig", "hand-eye", *map(str, arguments)])
    return code, *capsys.readouterr()


def write_poses(path, plan, names=None):
    poses = plan.T_base_tool.tolist()
    listed = poses if names is None else dict(zip(names, poses, strict=True))
    path.write_text(json.dumps({"T_base_tool": listed}))
    return path


@pytest.mark.slow
def test_rendered_scans_give_the_pose_of_the_camera_on_the_tool(capsys, tmp_path, mitsuba_renderer):
    """All steps are those of a real calibration: light, noise, decoding, corners and the fit."""
    scanner = preset("like-phoxi-m", "small")
    T_cam_board = boards_in_view(6, np.random.default_rng(3))
    plan = cell(6, "in-hand", seed=0, T_cam_board=T_cam_board)
    names = [f"pose{i + 7}" for i in range(6)]  # By name, pose10 follows pose9.
    for i, T in enumerate(T_cam_board):
        scene = in_camera(scanner.rig, textured_board(BOARD, T))
        rendering = mitsuba_renderer.render(
            scene, EMPTY_LAYOUT, patterns_of(scanner), quality=Quality(samples=16, depth=1), seed=i
        )
        raw = Raw(scanner=scanner, capture=take(scanner, rendering.radiance, seed=i))
        for name, content in raw_files(raw):
            path = tmp_path / "scans" / names[i] / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    poses, out = write_poses(tmp_path / "poses.json", plan), tmp_path / "hand_eye.yaml"
    arguments = (tmp_path / "scans", "--poses", poses, "--board", TEXT, "--out", out)
    code, printed, complaint = command(capsys, *arguments)
    assert code == 0, complaint
    assert "error at the gripper by the calibration alone" in printed
    result = yaml.safe_load(out.read_text())
    assert list(result["scans"]) == names
    T, point_m = np.array(result["T_tool_cam"]), np.array(result["at_point_cam_m"])
    assert error_m(T, plan, point_m) < 3 * result["error_at_gripper_m"]
    assert error_m(T, plan, point_m) < 3e-4


def pictures_of(plan, folder, names):
    """Write pictures of boards in 8 bits with depth as millimetres, from the planes' equations."""
    camera = plan.rig.camera
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    ray = rays(camera, np.stack([x, y], axis=-1).astype(np.float64))
    for part in ("gray", "depth"):
        (folder / part).mkdir(parents=True)
    for name, T in zip(names, plan.T_cam_board(), strict=True):
        z_m = T[:3, 2] @ T[:3, 3] / (ray @ T[:3, 2])
        on_board = (ray * z_m[..., None] - T[:3, 3]) @ T[:3, :2] / BOARD.square_m
        i, j = np.moveaxis(np.floor(on_board), -1, 0)
        inside = (i >= 0) & (i < 9) & (j >= 0) & (j < 6)
        grey = np.where(inside & ((i + j) % 2 == 0), 30, 200).astype(np.uint8)
        cv2.imwrite(str(folder / "gray" / f"{name}.png"), cv2.GaussianBlur(grey, (0, 0), 1.0))
        cv2.imwrite(str(folder / "depth" / f"{name}.png"), np.rint(1e4 * z_m).astype(np.uint16))


@pytest.mark.slow
def test_pictures_with_depth_calibrate_a_fixed_scanner(capsys, tmp_path):
    """One picture has no board, so its scan is left out with its pose."""
    plan = cell(7, "to-hand", seed=5)
    names = ["a", "b", "c", "d", "e", "f", "g"]
    pictures_of(plan, tmp_path / "scans", names)
    camera = plan.rig.camera
    blank = np.random.default_rng(0).integers(90, 110, (camera.height_px, camera.width_px))
    cv2.imwrite(str(tmp_path / "scans" / "gray" / "c.png"), blank.astype(np.uint8))
    K = f"{camera.fx_px},{camera.fy_px},{camera.cx_px},{camera.cy_px}"
    out = tmp_path / "hand_eye.yaml"
    code, _, complaint = command(
        capsys, tmp_path / "scans", "--poses", write_poses(tmp_path / "p.json", plan, names),
        "--board", TEXT, "--mount", "to-hand", "--intrinsics", K, "--scale", 0.0001,
        "--distortion", ",".join(map(str, camera.distortion)), "--out", out,
    )  # fmt: skip
    assert code == 0, complaint
    assert "scan c is left out: no chessboard of 9 x 6 squares" in complaint
    result = yaml.safe_load(out.read_text())
    assert list(result["scans"]) == ["a", "b", "d", "e", "f", "g"]
    T, point_m = np.array(result["T_base_cam"]), np.array(result["at_point_cam_m"])
    assert error_m(T, plan, point_m) < 1e-4


def test_a_simulation_prints_the_predicted_error(capsys, tmp_path):
    plan = cell(8, "in-hand", seed=1)
    guess = tmp_path / "guess.yaml"
    known = {"T_tool_cam": plan.T_robot_cam, "T_base_board": plan.T_other_board}
    guess.write_text(json.dumps({name: T.tolist() for name, T in known.items()}))
    poses = write_poses(tmp_path / "p.json", plan)
    arguments = ("--simulate", 3, "--poses", poses, "--board", TEXT,
                 "--rig", "like-phoxi-m", "--guess", guess)  # fmt: skip
    errors = []
    for noise in ("0.0001,0.0002", "0.001,0.002"):
        code, printed, complaint = command(capsys, *arguments, "--robot-noise", noise)
        assert code == 0, complaint
        assert "RMS error of 3 simulated calibrations" in printed
        errors.append(float(printed.split("with 8 poses: ")[1].split(" mm")[0]))
    assert 0.05 < errors[0] < 1
    assert errors[1] > 5 * errors[0]  # The noise of corners stays the same.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give either a folder of scans, or --simulate N"),
        (("--simulate", 0), "--simulate needs the scanner: give --rig"),
        (("scans",), "--out is missing"),
        (("scans", "--out", "o.yaml"), "has no scans: give a folder"),
    ],
)
def test_missing_arguments_are_named(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scans").mkdir()
    poses = write_poses(tmp_path / "p.json", cell(5, "in-hand", seed=1))
    code, _, complaint = command(capsys, *arguments, "--poses", poses, "--board", TEXT)
    assert code != 0
    assert message in complaint
