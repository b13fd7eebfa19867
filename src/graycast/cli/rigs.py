"""The command rig with its subcommands, and the command patterns."""

import argparse
import sys
from pathlib import Path

from ..base.errors import GraycastError
from ..base.folder import whole_folder
from ..rig.pattern import CODECS
from .arguments import above_zero, add_command, add_rig, resolve_rig_option, size


def add_commands(commands) -> None:
    rig = add_command(
        commands, "rig", lambda _: rig.print_help(), "Draw, write, import or calibrate a rig."
    )
    rigs = rig.add_subparsers(metavar="COMMAND")
    show = add_command(rigs, "show", _rig_show, "Print the properties of a rig, and draw it.")
    add_rig(show)
    show.add_argument("--out", type=Path, help="A PNG file in which the rig is drawn.")
    write = add_command(
        rigs, "write", _rig_write, "Write a preset as a rig file, which can then be edited."
    )
    add_rig(write)
    write.add_argument("--out", type=Path, required=True, help="The YAML file to write.")
    _add_import(rigs)
    _add_calibrate(rigs)

    patterns = add_command(
        commands,
        "patterns",
        _patterns,
        "Write the patterns of a rig as PNG files for a projector, and the stack file for "
        "graycast decode.",
    )
    add_rig(patterns)
    patterns.add_argument(
        "--out", type=Path, required=True, help="The folder to which the patterns are written."
    )
    patterns.add_argument(
        "--codec", choices=CODECS, help="The code of the patterns (default: the rig's own)."
    )
    patterns.add_argument(
        "--inverses", action="store_true", help="Also write the inverse of each pattern."
    )


def _add_import(rigs) -> None:
    load = add_command(
        rigs, "import", _rig_import, "Make a rig file from a stereo calibration of OpenCV."
    )
    load.add_argument(
        "calibration",
        type=Path,
        help="The calibration file: YAML, XML, JSON or NPZ with the matrices K, D, R and T.",
    )
    load.add_argument("--out", type=Path, required=True, help="The YAML file to write.")
    load.add_argument(
        "--unit",
        choices=("m", "mm"),
        help="The unit of the translation T. It is needed only if the numbers do not make it "
        "clear.",
    )
    load.add_argument(
        "--near",
        type=above_zero,
        help="The nearest working distance in metres (default: the distance at which the "
        "fields of view of camera and projector begin to overlap).",
    )
    load.add_argument(
        "--far",
        type=above_zero,
        help="The farthest working distance in metres (default: the distance at which the "
        "overlap of the two fields of view ends).",
    )
    for device in ("camera", "projector"):
        load.add_argument(
            f"--{device}-size",
            type=size,
            metavar="WxH",
            help=f"The width and height of the {device} in pixels. It is needed only if the "
            "file does not state them.",
        )


def _add_calibrate(rigs) -> None:
    calibrate = add_command(
        rigs,
        "calibrate",
        _rig_calibrate,
        "Calibrate a rig from stacks of one flat board in three or more poses.",
    )
    calibrate.add_argument(
        "stacks",
        type=Path,
        nargs="+",
        help="The stack files, one for each pose of the board. Each stack must code columns "
        "and rows.",
    )
    calibrate.add_argument(
        "--board",
        required=True,
        help="The board: chessboard:9x6:0.025 states the numbers of squares and their side "
        "in metres; charuco:8x5:0.03:0.022:DICT_5X5_100 adds the side of the markers "
        "and their dictionary. Add :legacy at the end for a ChArUco board in the layout of OpenCV "
        "before 4.6.",
    )
    calibrate.add_argument("--out", type=Path, required=True, help="The YAML file to write.")
    calibrate.add_argument(
        "--near",
        type=above_zero,
        help="The nearest working distance in metres (default: 10 %% less than the distance "
        "of the nearest corner).",
    )
    calibrate.add_argument(
        "--far",
        type=above_zero,
        help="The farthest working distance in metres (default: 10 %% more than the distance "
        "of the farthest corner).",
    )
    calibrate.add_argument(
        "--radial-terms",
        type=int,
        choices=range(4),
        default=3,
        help="The largest number of radial distortion coefficients of each lens. "
        "Coefficients that the corners do not determine are set to 0 (default: 3).",
    )


def _rig_show(options: argparse.Namespace) -> int:
    from ..show.report import describe_rig, draw_rig

    rig = resolve_rig_option(options).rig
    print(describe_rig(rig))
    if options.out is not None:
        draw_rig(rig, options.out)
        print(options.out)
    return 0


def _rig_write(options: argparse.Namespace) -> int:
    from ..camera.rig_file import save_scanner

    save_scanner(resolve_rig_option(options), options.out)
    print(options.out)
    return 0


def _rig_import(options: argparse.Namespace) -> int:
    from ..camera.rig_file import import_opencv, missing_distortions, save_scanner
    from ..camera.scanner import Scanner
    from ..show.report import describe_rig

    rig = import_opencv(
        options.calibration,
        unit=options.unit,
        near_m=options.near,
        far_m=options.far,
        camera_size_px=options.camera_size,
        projector_size_px=options.projector_size,
    )
    save_scanner(Scanner(rig=rig), options.out)
    print(describe_rig(rig))
    for missing in missing_distortions(options.calibration):
        print(f"graycast: warning: {missing}", file=sys.stderr)
    print(options.out)
    return 0


def _patterns(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from ..camera.stack import describe_code
    from ..rig.pair import grey_levels
    from ..rig.pattern import CodeSpec, write_pngs

    scanner = resolve_rig_option(options)
    spec = scanner.code
    # the settings of the rig's own code apply only to that code
    if options.codec not in (None, spec.codec):
        spec = CodeSpec(codec=options.codec, axes=spec.axes)
    if options.inverses:
        spec = replace(spec, inverses=True)
    projector = scanner.rig.projector
    code = spec.code(projector.width_px, projector.height_px)
    with whole_folder(options.out) as folder:
        written = [
            path.name
            for path in write_pngs(
                code, folder, grey_levels=lambda share: grey_levels(scanner.rig, share)
            )
        ]
        others = {path.name for path in options.out.glob("*.png")}.difference(written)
        if others:
            raise GraycastError(
                f"{options.out}: holds pictures of another code, such as {min(others)}, which a "
                "projector would show too: choose an empty folder"
            )
        (folder / "stack.yaml").write_text(describe_code(code, written), encoding="utf-8")
        written.append("stack.yaml")
    for name in written:
        print(options.out / name)
    return 0


def _rig_calibrate(options: argparse.Namespace) -> int:
    from ..camera.rig_file import save_scanner
    from ..camera.scanner import Scanner
    from ..real.calibrate import calibrate_rig, describe_calibration, parse_board, read_view

    board = parse_board(options.board)
    views, sizes_px = [], set()
    for path in options.stacks:
        print(path)
        view, size_px = read_view(path)
        views.append(view)
        sizes_px.add(size_px)
    if len(sizes_px) > 1:
        sizes = ", ".join(f"{w} x {h}" for w, h in sorted(sizes_px))
        raise GraycastError(
            f"the stacks were made with projectors of different sizes ({sizes} px): give stacks of "
            "one projector"
        )
    calibration = calibrate_rig(
        views,
        board,
        projector_size_px=sizes_px.pop(),
        name=options.out.stem,
        near_m=options.near,
        far_m=options.far,
        radial_terms=options.radial_terms,
    )
    save_scanner(Scanner(rig=calibration.rig), options.out)
    print(describe_calibration(calibration))
    for warning in calibration.warnings:
        print(f"graycast: warning: {warning}", file=sys.stderr)
    print(options.out)
    return 0
