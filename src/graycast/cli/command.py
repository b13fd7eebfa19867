"""The command `graycast`: files in, files out."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from . import __version__
from .errors import GraycastError
from .rig import PRESETS

EXAMPLES = """\
examples:
  graycast generate configs/demo.yaml --out out/demo     three scenes of brackets in a box
  graycast preview configs/own_part.yaml --out p.png     one scene of your own part as a picture
  graycast validate out/demo                             check a dataset from its files
  graycast rig show phoxi-m --out rig.png                what a rig sees, as a picture
  graycast doctor                                        what this machine has and lacks
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 failed, 2 wrong arguments."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options) or 0
    except KeyboardInterrupt:
        print("graycast: stopped; finished scenes are kept", file=sys.stderr)
        return 130
    except (GraycastError, ValueError, OSError, MemoryError) as error:
        if options.debug:
            raise
        text = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, OSError):
            text += ": check that path, that you may write there, and the free space"
        print(f"graycast: error: {text}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="graycast",
        description="Simulates a structured-light camera and makes bin-picking datasets with it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"graycast {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], int | None], help: str, into=None):
        made = (into or commands).add_parser(name, help=help, description=help)
        made.add_argument("--debug", action="store_true", help="show the traceback of an error")
        made.set_defaults(run=run)
        return made

    generate = command("generate", _generate, "Make a dataset, or go on with one.")
    _add_config(generate)
    generate.add_argument("--out", type=Path, required=True, help="the dataset's folder")
    generate.add_argument("--scenes", type=_positive, help="how many (default: as configured)")
    _add_seed(generate)
    _add_device(generate)
    generate.add_argument(
        "--workers", type=_positive, default=1, help="processes that share the cores (default 1)"
    )

    preview = command("preview", _preview, "Make one scene and draw it as a contact sheet.")
    _add_config(preview)
    preview.add_argument("--out", type=Path, required=True, help="the PNG to write")
    preview.add_argument("--scene", type=_seed, default=0, help="which scene (default 0)")
    _add_seed(preview)
    _add_device(preview)

    validate = command("validate", _validate, "Check a dataset from its files alone.")
    validate.add_argument("dataset", type=Path, help="the dataset's folder")

    parts = command("parts", _parts, "List parts and picture them: built-in or a configuration's.")
    parts.add_argument("config", type=Path, nargs="?", help="show this configuration's parts")
    parts.add_argument("--out", type=Path, help="also draw them into this PNG")
    _add_device(parts)

    rig = command("rig", lambda _: rig.print_help(), "Show, import and write rigs.")
    rigs = rig.add_subparsers(metavar="COMMAND")
    show = command("show", _rig_show, "Print a rig's figures and draw it.", rigs)
    _add_rig(show)
    show.add_argument("--out", type=Path, help="also draw it into this PNG")
    write = command("write", _rig_write, "Write a preset as a rig file to start from.", rigs)
    _add_rig(write)
    write.add_argument("--out", type=Path, required=True, help="the YAML to write")
    load = command("import", _rig_import, "Make a rig file from an OpenCV calibration.", rigs)
    load.add_argument("calibration", type=Path, help="YAML, XML, JSON or NPZ with K, D, R, T")
    load.add_argument("--out", type=Path, required=True, help="the YAML to write")
    load.add_argument("--unit", choices=("m", "mm"), help="of T; asked for where it is unclear")
    load.add_argument("--near", type=float, required=True, help="nearest working distance [m]")
    load.add_argument("--far", type=float, required=True, help="farthest working distance [m]")
    for device in ("camera", "projector"):
        load.add_argument(
            f"--{device}-size", type=_size, metavar="WxH", help="where the file states none"
        )

    patterns = command("patterns", _patterns, "Write a rig's patterns as PNGs for a projector.")
    _add_rig(patterns)
    patterns.add_argument("--out", type=Path, required=True, help="the folder to write")
    patterns.add_argument("--inverses", action="store_true", help="each bit and its inverse")

    command("doctor", _doctor, "Print what this machine has, lacks, and what that would give.")
    schema = command("schema", _schema, "Print the JSON Schema of a file, for editors.")
    schema.add_argument("kind", choices=("config", "rig"), help="which file")

    bench = command("bench", _bench, "Measure speed and memory on this machine.")
    bench.add_argument(
        "what", choices=("render", "decode", "drop", "scene"), help="which stage, or all of a scene"
    )
    bench.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    bench.add_argument("--count", type=_positive, default=30, help="parts per scene (default 30)")
    bench.add_argument("--scenes", type=_positive, default=3, help="for scene (default 3)")
    _add_device(bench)
    return parser


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="a YAML configuration; see configs/")


def _add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=_seed, help="of everything random (default: as configured)")


def _add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="auto takes CUDA where it works, else the CPU",
    )


def _add_rig(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("rig", help=f"a rig file, or one of {', '.join(PRESETS)}")
    parser.add_argument(
        "--resolution", choices=("low", "full"), default="low", help="of a preset (default low)"
    )


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(width), int(height)


# Heavy modules are imported by the command that needs them, so that --help answers at once.


def _load_cell(options: argparse.Namespace):
    from .config import load_config
    from .generate import resolve_cell

    config = load_config(options.config)
    try:
        cell = resolve_cell(config, options.config.parent)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    for note in cell.notes:
        print(f"note: {note}")
    return cell


def _generate(options: argparse.Namespace) -> int:
    from .generate import Progress, generate
    from .render.device import choose_device

    cell = _load_cell(options)
    config = cell.config
    scenes = options.scenes or config.scenes
    seed = config.seed if options.seed is None else options.seed
    device = choose_device(options.device)
    rig = cell.scene.rig
    print(
        f"{scenes} scenes of {', '.join(part.name for part in cell.scene.parts)} on {device}, "
        f"rig {rig.name}, seed {seed}, {options.workers} worker(s)"
    )
    with _progress_bar() as bar:
        task = bar.add_task("scenes", total=scenes)

        def on_progress(progress: Progress) -> None:
            decoded = progress.reasons["decoded"]
            bar.update(task, advance=1)
            bar.console.print(
                f"scene {progress.scene_id:06d}  {progress.seconds:6.1f} s  {decoded:.1%} decoded"
            )

        summary = generate(
            cell,
            options.out,
            scenes=scenes,
            seed=seed,
            device=options.device,
            workers=options.workers,
            on_start=lambda found: bar.update(task, completed=found),
            on_progress=on_progress,
        )
    print(f"{options.out}: {summary.written} scenes made, {summary.found} were there", end="")
    print(f", {summary.seconds:.1f} s")
    for name, share in summary.reasons.items():
        print(f"  {name:18} {share:7.2%} of the pixels")
    return 0


def _progress_bar():
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )


def _preview(options: argparse.Namespace) -> int:
    from .generate import make_scene
    from .render.device import choose_device, open_device
    from .report import draw_preview

    cell = _load_cell(options)
    device = choose_device(options.device)
    print(f"scene {options.scene} on {device}")
    open_device(device)
    seed = cell.config.seed if options.seed is None else options.seed
    shot = make_scene(cell, options.scene, seed=seed, device=device)
    draw_preview(shot, cell.code, options.out)
    for name, share in shot.sample.manifest["reasons"].items():
        print(f"  {name:18} {share:7.2%} of the pixels")
    print(options.out)
    return 0


def _validate(options: argparse.Namespace) -> int:
    from .dataset import validate

    problems = validate(options.dataset)
    for problem in problems:
        print(problem)
    print(
        f"{options.dataset}: {len(problems)} problem(s)"
        if problems
        else f"{options.dataset}: valid"
    )
    return 1 if problems else 0


def _parts(options: argparse.Namespace) -> int:
    from .parts import BUILTIN, builtin_part
    from .report import describe_parts, draw_parts

    if options.config is None:
        shown = tuple(builtin_part(name) for name in BUILTIN)
    else:
        shown = _load_cell(options).scene.parts
    print(describe_parts(shown))
    if options.out is not None:
        from .render.device import choose_device, open_device

        device = choose_device(options.device)
        open_device(device)
        draw_parts(shown, options.out, device=device)
        print(options.out)
    return 0


def _resolve_rig(options: argparse.Namespace):
    from .rig_file import resolve_rig

    return resolve_rig(options.rig, folder=Path(), resolution=options.resolution)


def _rig_show(options: argparse.Namespace) -> int:
    from .report import describe_rig, draw_rig

    rig = _resolve_rig(options)
    print(describe_rig(rig))
    if options.out is not None:
        draw_rig(rig, options.out)
        print(options.out)
    return 0


def _rig_write(options: argparse.Namespace) -> int:
    from .rig_file import save_rig

    save_rig(_resolve_rig(options), options.out)
    print(options.out)
    return 0


def _rig_import(options: argparse.Namespace) -> int:
    from .report import describe_rig
    from .rig_file import import_opencv, save_rig

    rig = import_opencv(
        options.calibration,
        unit=options.unit,
        near_m=options.near,
        far_m=options.far,
        camera_size_px=options.camera_size,
        projector_size_px=options.projector_size,
    )
    save_rig(rig, options.out)
    print(describe_rig(rig))
    print(options.out)
    return 0


def _patterns(options: argparse.Namespace) -> int:
    from .pattern import GrayCode, write_pngs

    projector = _resolve_rig(options).projector
    code = GrayCode(
        width_px=projector.width_px, height_px=projector.height_px, inverses=options.inverses
    )
    for path in write_pngs(code, options.out):
        print(path)
    return 0


def _doctor(options: argparse.Namespace) -> int:
    from .doctor import describe, examine

    print(describe(examine()))
    return 0


def _schema(options: argparse.Namespace) -> int:
    from .config import config_schema
    from .rig_file import rig_schema

    print(json.dumps({"config": config_schema, "rig": rig_schema}[options.kind](), indent=2))
    return 0


def _bench(options: argparse.Namespace) -> int:
    from . import bench

    figures: dict[str, Any] = bench.run(
        options.what, device=options.device, count=options.count, scenes=options.scenes
    )
    print(bench.describe(figures))
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        print(options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
