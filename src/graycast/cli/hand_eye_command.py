"""The command rig hand-eye, which calibrates a scanner on a robot or predicts the error."""

import argparse
import sys
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import add_command, add_option, add_out, add_shared, resolve_rig_option
from .readers import above_zero, numbers, reader

# Heavy modules are imported by the command, so that --help answers at once.

HAND_EYE = """\
The scanner sees a board from at least four poses of the tool, better ten or more, between which the
tool turns by 20 to 40 degrees about two or three axes. SCANS is a folder of folders with a
stack.yaml each, or of the folders rgb (or gray) and depth with files of the same names, which need
--intrinsics or --rig. With --mount in-hand, the robot carries the scanner, and the result is
T_tool_cam; with to-hand, the robot carries the board, and the result is T_base_cam.

The poses are T_base_tool, which maps coordinates of the tool to those of the robot's base. A CSV
file has the columns x_m,y_m,z_m (or x_mm and so on) and either qx,qy,qz,qw (quaternion) or
rx_rad,ry_rad,rz_rad (rotation vector; or rx_deg and so on), and optionally scan, the name of the
scan. A YAML or JSON file has the key T_base_tool with 4 x 4 matrices, by the names of the scans or
as a list in their order, and optionally unit: mm. Euler angles are refused, because their order
differs from robot to robot.

The command refuses poses that fit far better after a usual mistake is undone, and names it. With
--simulate, it needs no scans: it predicts which error at the gripper the poses will give, in closed
form, and states the errors of as many simulated calibrations; 0 gives the prediction alone."""

robot_noise = reader(
    numbers,
    lambda pair: len(pair) == 2 and min(pair) > 0,
    "two numbers METRES,RADIANS such as 0.0001,0.0002",
)


def add_hand_eye(group) -> None:
    command = add_command(
        group, "hand-eye", _hand_eye, "Calibrate a scanner on a robot from scans of a board.",
        example="scans --poses poses.csv --board chessboard:9x6:0.025 --out hand_eye.yaml",
        more=HAND_EYE,
    )  # fmt: skip
    scans = "The folder of scans. --simulate needs none."
    add_option(command, "scans", Path, scans, nargs="?")
    poses = "The CSV, YAML or JSON file with a pose T_base_tool for each scan."
    add_option(command, "--poses", Path, poses, required=True, metavar="FILE")
    add_shared(command, "--board", required=True)
    mount = "Whether the robot carries the scanner (in-hand) or the board (to-hand)."
    add_option(command, "--mount", ("in-hand", "to-hand"), mount, "in-hand")
    add_shared(command, "--rig", usual="the rig that a stack file names")
    add_shared(command, "--resolution", usual="low")
    add_shared(command, "--intrinsics", "--distortion", "--scale", "--ray-length")
    add_out(command, "The YAML file to write. Only --simulate needs none.", required=False)
    add_shared(command, "--simulate", usual="the scans are calibrated")
    add_option(
        command, "--guess", Path,
        "A YAML file with T_tool_cam (or T_base_cam) and T_base_board (or T_tool_board), such as "
        "an earlier result, for --simulate.",
        usual="the camera is at the tool, and the board where the cameras look",
    )  # fmt: skip
    pixels = "The standard deviation of corners and of projector columns, for --simulate."
    add_option(command, "--corner-noise", above_zero, pixels, 0.05, metavar="PX")
    robot = "The standard deviations of the robot's position and rotation, for --simulate."
    add_option(command, "--robot-noise", robot_noise, robot, (1e-4, 2e-4),
               usual="0.0001,0.0002", metavar="METRES,RADIANS")  # fmt: skip
    add_shared(command, "--seed", default=0)


def _hand_eye(options: argparse.Namespace) -> None:
    from ..real.calibrate import parse_board
    from ..real.calibrate.hand_eye import read_poses

    if (options.simulate is None) != (options.scans is not None):
        raise GraycastError("give either a folder of scans, or --simulate N")
    if options.rig is None and options.resolution is not None:
        raise GraycastError("--resolution applies only to a preset: add --rig, or remove it")
    board, poses = parse_board(options.board), read_poses(options.poses)
    scanner = None if options.rig is None else resolve_rig_option(options)
    if options.simulate is not None:
        _simulate(options, board, poses, scanner)
    else:
        _calibrate(options, board, poses, scanner)


def _calibrate(options: argparse.Namespace, board, poses, scanner) -> None:
    from ..real.calibrate.board import CalibrationError
    from ..real.calibrate.hand_eye import (
        calibrate_hand_eye,
        describe_hand_eye,
        read_scans,
        scan_board,
        write_hand_eye,
    )
    from ..real.depth_file import FileOptions, read_intrinsics

    if options.out is None:
        raise GraycastError("--out is missing: give the YAML file to write")
    files = FileOptions(
        K=None if options.intrinsics is None else read_intrinsics(options.intrinsics),
        distortion=options.distortion,
        scale_m=options.scale,
        ray_length=options.ray_length,
    )
    names, usable, without, camera = [], [], {}, None
    for scan in read_scans(options.scans, scanner, files):
        print(scan.name)
        names.append(scan.name)
        camera = scan.camera if camera is None else camera
        if scan.picture.shape != (camera.height_px, camera.width_px):
            raise GraycastError(f"scan {scan.name} has another size: give scans of one camera")
        try:
            usable.append(
                scan_board(scan.name, scan.picture, scan.depth_m, scan.sigma_m, camera, board)
            )
        except CalibrationError as error:
            without[scan.name] = str(error)
    matched = poses.of(names, options.poses).only([one.name for one in usable], names)
    for name, why in without.items():
        _warn(f"scan {name} is left out: {why}")
    assert camera is not None  # there is at least one scan
    result = calibrate_hand_eye(usable, matched, board, camera, mount=options.mount)
    write_hand_eye(result, options.out)
    print(describe_hand_eye(result))
    for name, why in result.left_out.items():
        _warn(f"scan {name} is left out: {why}")
    for warning in result.warnings:
        _warn(warning)
    print(options.out)


def _warn(text: str) -> None:
    print(f"graycast: warning: {text}", file=sys.stderr)


def _simulate(options: argparse.Namespace, board, poses, scanner) -> None:
    import numpy as np

    from ..real.calibrate.hand_eye import (
        CellNoise,
        Plan,
        describe_prediction,
        middle_of_views,
        predict,
        read_guess,
        simulated_errors_m,
    )

    if scanner is None:
        raise GraycastError("--simulate needs the scanner: give --rig")
    if options.guess is None and options.mount == "to-hand":
        raise GraycastError(
            "--simulate with --mount to-hand needs the scanner's pose: give --guess with T_base_cam"
        )
    camera, at = (np.eye(4), None) if options.guess is None else read_guess(
        options.guess, options.mount
    )  # fmt: skip
    if at is None and options.mount == "to-hand":
        raise GraycastError(f"{options.guess}: has no T_tool_board, which to-hand needs: add it")
    if at is None:
        rig = scanner.rig
        distance_m = (rig.near_m + rig.far_m) / 2
        at = middle_of_views(poses.T_base_tool @ camera, board, distance_m)
    m, rad = options.robot_noise
    plan = Plan(
        mount=options.mount,
        rig=scanner.rig,
        board=board,
        T_base_tool=poses.T_base_tool,
        T_robot_cam=camera,
        T_other_board=at,
        noise=CellNoise(corner_px=options.corner_noise, robot_rad=rad, robot_m=m),
    )
    prediction = predict(plan)
    print(describe_prediction(plan, prediction))
    if options.simulate:
        rng = np.random.default_rng(options.seed)
        error_m = simulated_errors_m(plan, prediction.point_m, options.simulate, rng)
        rms_mm = 1e3 * np.sqrt(np.mean(np.square(error_m)))
        print(f"RMS error of {len(error_m)} simulated calibrations: {rms_mm:.3f} mm")
