"""Commands for rigs: list, show, write, import, calibrate, patterns, decode, certify, design."""

import argparse
import sys
from collections.abc import Iterable
from contextlib import nullcontext
from pathlib import Path

from ..base.errors import GraycastError
from ..base.folder import refuse_foreign, whole_folder
from ..base.progress import UNWATCHED
from ..rig.pattern import CODECS
from .arguments import (
    CONTINUE,
    add_command,
    add_device,
    add_group,
    add_option,
    add_out,
    add_png,
    add_rig,
    add_shared,
    add_workers,
    failed_line,
    print_missing,
    resolve_rig_option,
    workers_of,
)
from .bars import open_bars
from .hand_eye_command import add_hand_eye
from .readers import above_zero, length_m, metres, motion_m, sides_m, size

# Heavy modules are imported by the command that needs them, so that --help answers at once.

DESIGN = """\
The command scans the same heaps of parts with each setting of the study: scanners, their poses,
codes, exposures and bins. For each setting it reports the share of the parts' surface that is
measured, the depth error, the share and the reasons of missing depth, the smallest feature that is
resolved, and the duration of a scan in seconds. It writes tables, a plot of the best settings and a
picture of each setting to the folder. If the command is stopped, the same command continues the
study; settings and heaps may be added."""


def add_commands(commands) -> None:
    group = add_group(
        commands, "rig", "List, draw, write, calibrate, certify, compare and decode scanners."
    )
    _add_list(group)
    show = add_command(
        group, "show", _show, "Print the properties of a rig, and draw it.",
        example="like-phoxi-m --out rig.png",
    )  # fmt: skip
    add_rig(show)
    add_png(show)
    write = add_command(
        group, "write", _write, "Write a preset as a rig file, which can then be edited.",
        example="like-phoxi-m --out rig.yaml",
    )  # fmt: skip
    add_rig(write)
    add_out(write, "The YAML file to write.")
    _add_files(group)
    _add_pictures(group)
    certify = add_command(
        group, "certify", _certify, "Measure the accuracy of a virtual scanner.",
        example="like-phoxi-l --out out/sheet",
        more="The scanner measures virtual artefacts: planes, spheres and ball bars.",
    )  # fmt: skip
    add_rig(certify)
    add_out(certify, "The folder to write.")
    add_shared(certify, "--seed", default=0)
    add_shared(certify, "--backend", default="mitsuba")
    add_device(certify)

    design = add_command(
        group, "design", _design, "Compare scanners and their poses, and recommend one.",
        example="configs/design/brackets.yaml --out out/design", more=DESIGN,
        when_stopped=f"the finished scans are kept; {CONTINUE}",
    )  # fmt: skip
    file = "The YAML file of the study, such as configs/design/brackets.yaml."
    add_option(design, "study", Path, file)
    add_out(design, "The folder to write.")
    add_shared(design, "--list")
    add_device(design)
    add_workers(design)


def _add_list(group) -> None:
    shelf = add_command(
        group, "list", _list, "List the scanners with names, or those that fit.",
        example="--field 0.6x0.4 --at 1 --noise 0.0002",
        more="With options, the command lists the scanners that see a field at a distance.",
    )  # fmt: skip
    sides = "The width and height in metres of a rectangle that the scanner must see and light."
    add_option(shelf, "--field", sides_m, sides)
    distance = "The distance from the camera along its axis in metres. --field and --noise need it."
    add_option(shelf, "--at", length_m, distance)
    noise = "The largest temporal noise of depth in metres, one standard deviation, as python -m "
    add_option(shelf, "--noise", metres(above_zero, 0.1), f"{noise}benchmarks shelf measured it.")


def _add_files(group) -> None:
    """Add the commands that make a rig file for a real scanner: import and calibrate."""
    load = add_command(
        group, "import", _import, "Make a rig file from a stereo calibration of OpenCV.",
        example="stereo.yml --out rig.yaml",
    )  # fmt: skip
    file = "The calibration file: YAML, XML, JSON or NPZ with the matrices K, D, R and T."
    add_option(load, "calibration", Path, file)
    add_out(load, "The YAML file to write.")
    add_shared(load, "--unit")
    overlap = "where the overlap of the fields of view of camera and projector"
    add_shared(load, "--near", usual=f"{overlap} begins")
    add_shared(load, "--far", usual=f"{overlap} ends")
    for device in ("camera", "projector"):
        pixels = f"The width and height of the {device} in pixels."
        needed = "It is needed only if the file does not state them."
        add_option(load, f"--{device}-size", size, f"{pixels} {needed}")

    calibrate = add_command(
        group, "calibrate", _calibrate, "Calibrate a rig from stacks of one flat board.",
        example="pose*/stack.yaml --board chessboard:9x6:0.025 --out rig.yaml",
        more="The board is in three or more poses.",
    )  # fmt: skip
    add_option(
        calibrate,
        "stacks",
        Path,
        "The stack files, one for each pose of the board. Each stack must code columns and rows.",
        nargs="+",
    )
    add_shared(calibrate, "--board", required=True)
    add_out(calibrate, "The YAML file to write.")
    add_shared(calibrate, "--near", usual="10 %% less than the distance of the nearest corner")
    add_shared(calibrate, "--far", usual="10 %% more than the distance of the farthest corner")
    calibrate.add_argument(
        "--radial-terms",
        type=int,
        choices=range(4),
        default=3,
        help="The largest number of radial distortion coefficients of each lens. "
        "Coefficients that the corners do not determine are set to 0 (default: 3).",
    )
    add_hand_eye(group)


def _add_pictures(group) -> None:
    """Add the commands for patterns and for pictures of them: patterns and decode."""
    patterns = add_command(
        group, "patterns", _patterns, "Write the patterns of a rig for a projector.",
        example="rig.yaml --out out/patterns",
        more="The patterns are PNG files, beside the stack file for graycast rig decode.",
    )  # fmt: skip
    add_rig(patterns)
    add_out(patterns, "The folder to write.")
    code = "The code of the patterns."
    add_option(patterns, "--codec", tuple(CODECS), code, usual="the rig's own")
    add_option(patterns, "--inverses", None, "Also write the inverse of each pattern.")

    decode = add_command(
        group, "decode", _decode, "Decode a scanner's pictures to depth.",
        example="stack.yaml --rig rig.yaml --out out/cloud",
        more="With a rig, the command also writes depth and a point cloud; without one, it writes "
        "projector coordinates alone.",
    )  # fmt: skip
    stack = "The stack file, which describes each picture, or a folder that holds a stack.yaml."
    add_option(decode, "stack", Path, stack)
    add_shared(decode, "--rig", usual="the rig that the stack file names, if any")
    add_shared(decode, "--resolution", usual="low")
    average = "Write one 3D point for each projector pixel instead of each camera pixel."
    add_option(decode, "--average", None, average)
    motion = (
        "Take the pictures of a scene that moves steadily back to the middle picture. The assumed "
        "motion from picture to picture, in metres along x, y and z of the camera, is where the "
        "search for the motion starts: 0,0,0 for small motions; a negative number needs --motion=."
    )
    add_option(decode, "--motion", motion_m, motion, metavar="X,Y,Z")
    add_out(decode, "The folder to write.")


def _list(options: argparse.Namespace) -> None:
    from ..rig.shelf import LEGEND
    from ..show.report import shelf_lines

    if options.at is None and (options.field, options.noise) != (None, None):
        raise GraycastError("--field and --noise apply at a distance: add --at")
    lines = shelf_lines(field_m=options.field, at_m=options.at, noise_m=options.noise)
    if not lines:
        print("no scanner with a name fits: graycast rig list prints them all")
        return
    print("\n".join([*lines, LEGEND, "graycast rig show NAME prints the source of each number."]))


def _show(options: argparse.Namespace) -> None:
    from ..rig.former_names import current_name
    from ..rig.pair import PRESETS
    from ..rig.shelf import source_lines
    from ..show.report import describe_rig, draw_rig

    rig = resolve_rig_option(options).rig
    print(describe_rig(rig))
    if rig.name in PRESETS and current_name(options.rig) == rig.name:
        print("where its numbers are from:")
        print("\n".join(f"  {line}" for line in source_lines(rig.name)))
    if options.out is not None:
        draw_rig(rig, options.out)
        print(options.out)


def _write(options: argparse.Namespace) -> None:
    from ..camera.rig_file import save_scanner

    save_scanner(resolve_rig_option(options), options.out)
    print(options.out)


def _import(options: argparse.Namespace) -> None:
    from ..camera.rig_file import import_opencv, missing_distortions
    from ..show.report import describe_rig

    rig = import_opencv(
        options.calibration,
        unit=options.unit,
        near_m=options.near,
        far_m=options.far,
        camera_size_px=options.camera_size,
        projector_size_px=options.projector_size,
    )
    _save(rig, options.out, describe_rig(rig), missing_distortions(options.calibration))


def _save(rig, out: Path, text: str, warnings: Iterable[str]) -> None:
    from ..camera.rig_file import save_scanner
    from ..camera.scanner import Scanner

    save_scanner(Scanner(rig=rig), out)
    print(text)
    for warning in warnings:
        print(f"graycast: warning: {warning}", file=sys.stderr)
    print(out)


def _patterns(options: argparse.Namespace) -> None:
    from dataclasses import replace

    from ..camera.stack import describe_code
    from ..rig.pair import grey_levels
    from ..rig.pattern import CodeSpec, write_pngs

    scanner = resolve_rig_option(options)
    spec = scanner.named_code()
    # The settings of the rig's own code apply only to that code.
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


def _calibrate(options: argparse.Namespace) -> None:
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
    text = describe_calibration(calibration)
    _save(calibration.rig, options.out, text, calibration.warnings)


def _decode(options: argparse.Namespace) -> None:
    from ..camera.stack import (
        CODE,
        decode_stack,
        describe_result,
        read_description,
        stack_scanner,
        unread_settings,
        write_result,
    )

    refuse_foreign(options.out, CODE)
    stack = options.stack / "stack.yaml" if options.stack.is_dir() else options.stack
    scanner = stack_scanner(stack) if options.rig is None else resolve_rig_option(options)
    with nullcontext(UNWATCHED) if options.motion is None else open_bars() as progress:
        result = decode_stack(
            stack,
            None if scanner is None else scanner.rig,
            average=options.average,
            filters=None if scanner is None else scanner.filters,
            motion_m=options.motion,
            progress=progress,
        )
    written = write_result(result, options.out)
    print(describe_result(result))
    if scanner is not None:
        for note in unread_settings(read_description(stack), scanner.decode):
            print(f"note: {note}")
    for path in written:
        print(path)


def _certify(options: argparse.Namespace) -> None:
    from ..rendering import open_renderer
    from ..score.metrology import CERTIFICATE, certify, describe, write_certificate

    scanner = resolve_rig_option(options)
    refuse_foreign(options.out, CERTIFICATE)
    with (
        whole_folder(options.out) as folder,
        open_renderer(options.backend, device=options.device) as renderer,
        open_bars() as bars,
    ):
        certificate = certify(scanner, renderer=renderer, seed=options.seed, progress=bars)
        page = write_certificate(certificate, folder)
    print(describe(certificate))
    print(options.out / page.name)


def _design(options: argparse.Namespace) -> int:
    from ..score.design import describe_design, read_design, run_design, settings_of, write_design

    workers = workers_of(options)
    spec = read_design(options.study)
    settings = settings_of(spec)
    if options.list:
        print("\n".join(setting.name for setting in settings))
        return 0
    print(f"{len(settings)} settings, {spec.layouts} heaps of parts, seed {spec.seed}")
    with open_bars() as bars:

        def report(name, layout, outcome) -> None:
            shares = ", ".join(f"{share:.1%}" for share in outcome.reasons.values())
            bars.line(f"{name}  heap {layout:03d}  {outcome.seconds:6.1f} s  {shares} measured")

        def failed(name, layout, outcome) -> None:
            bars.line(failed_line(f"{name}  heap {layout:03d}", outcome))

        lost = run_design(
            spec,
            options.out,
            device=options.device,
            workers=workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    write_design(spec, options.out)
    print(describe_design(spec, options.out))
    print_missing(lost)
    return 1 if lost else 0
