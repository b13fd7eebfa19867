"""Arguments of commands, with a table of the flags that several commands share."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..base.errors import GraycastError, one_line
from ..base.frames import UNITS_M
from ..rig.pair import PRESETS, RESOLUTIONS
from .bars import open_stages
from .readers import (
    above_zero,
    distortion,
    length_m,
    png_path,
    positive,
    share,
    sides_m,
    size,
    whole,
)

if TYPE_CHECKING:
    from ..cell.engine import Failed, Workers
    from ..real.depth_file import FileOptions

Run = Callable[[argparse.Namespace], int | None]
Kind = Callable[[str], Any] | tuple[str, ...] | None
Value = TypeVar("Value")
_DEBUG = "Print the Python traceback of an error, not only its message."
CONTINUE = "run the same command again to continue"
NOTHING = "nothing was written"


def add_group(commands, name: str, help: str):
    """Add a group of commands and return its subparsers. Without a command, it prints its help."""
    group = commands.add_parser(name, help=help, description=help)
    group.set_defaults(run=lambda _: group.print_help())
    group._positionals.title = "commands"
    return group.add_subparsers(metavar="COMMAND", required=False)


def add_command(
    into,
    name: str,
    run: Run,
    help: str,
    *,
    example: str,
    more: str = "",
    when_stopped: str = NOTHING,
) -> argparse.ArgumentParser:
    """Add a command and return its parser.

    Args:
        help: the command's text in the list of commands.
        example: frequent arguments, which the command's own help shows first.
        more: further sentences for the command's own help.
        when_stopped: text about the remaining files after Ctrl-C.
    """
    command = into.add_parser(name, help=help)
    words = " ".join(f"{help} {more}".split())
    line = f"{command.prog} {example}".rstrip()
    command.description = f"For example:\n  {line}\n\n{words}"
    rest = command.add_argument_group("about errors")  # This group is printed below the options.
    rest.add_argument("--debug", action="store_true", help=_DEBUG)
    command.set_defaults(run=run, when_stopped=when_stopped)
    return command


# --- the shared flags: each has one meaning ----------------------------------------------------

_METAVARS: Mapping[object, str] = {
    whole: "N", positive: "N", above_zero: "NUMBER", share: "SHARE", size: "WxH", sides_m: "WxH",
    Path: "PATH", distortion: "D", "--address": "HOST:PORT", "--shares": "SHARES",
    "--on": "DATASET", "--files": "FOLDER", "--config": "FILE", "--width": "PX", "--rig": "RIG",
    "--intrinsics": "K", "--board": "BOARD",
    "--scale": "METRES", "--near": "METRES", "--far": "METRES", "--at": "METRES",
    "--noise": "METRES",
}  # fmt: skip

SHARED: Mapping[str, tuple[Kind, str]] = {  # kind and help
    "--seed": (whole, "The seed of all random numbers. The same seed gives the same result."),
    "--rig": (str,
        f"The rig: a path to a rig file, or a name such as {', '.join(PRESETS[:4])}; graycast rig "
        "list prints all names."),
    "--device": (("auto", "cpu", "cuda", "optix"),
        "The device that renders or runs the network. auto uses the GPU if it works and the CPU "
        "otherwise; optix is for Cycles only."),
    "--backend": (("mitsuba", "cycles"),
        "The renderer. mitsuba renders all patterns in one pass; cycles renders them one after "
        "the other."),
    "--resolution": (RESOLUTIONS,
        "The resolution of a preset's pictures. A rig file states its own resolution, so this "
        "option is refused with one."),
    "--workers": (positive, "How many processes work at the same time."),
    "--threads": (positive, "The number of processor threads of each process."),
    "--engine": (("local", "ray"),
        "Where the workers run: local starts processes on this machine; ray uses a Ray cluster "
        "and needs pip install 'graycast[ray]'."),
    "--address": (str, "The address of the Ray cluster. It needs --engine ray."),
    "--scene": (whole, "The number of the scene, counted from 0."),
    "--split": (("train", "val", "test"), "The set of scenes that is used."),
    "--shares": (str,
        "The shares of scenes in the train, val and test sets, such as 0.8,0.1,0.1."),
    "--split-seed": (whole, "The seed of the division by --shares."),
    "--min-visibility": (share,
        "The smallest visible share of an instance, from 0 to 1. Instances below it are left "
        "out."),
    "--one-class": (None, "Treat all parts as one class, whatever their kind."),
    "--on": (Path, "The dataset to which the results belong, or an export of it."),
    "--resamples": (positive,
        "The number of bootstrap resamples of the scenes for the confidence intervals."),
    "--max-detections": (positive, "The largest number of detections in a picture."),
    "--min-score": (share, "The lowest score of a detection that is kept, from 0 to 1."),
    "--files": (Path,
        "The folder in which the relative paths of the stored configuration begin. It is needed "
        "only if the configuration names files by relative paths."),
    "--config": (Path, "The configuration of the cell, with its bin, rig and light."),
    "--width": (positive, "The largest width of a picture in pixels."),
    "--list": (None, "Only list the combinations, without running them."),
    "--intrinsics": (str,
        "The camera's intrinsics in pixels: the four numbers fx,fy,cx,cy, or a file that holds "
        "the camera matrix K."),
    "--distortion": (distortion,
        "The distortion coefficients of the lens in OpenCV's order: k1,k2,p1,p2,k3."),
    "--scale": (above_zero,
        "The length of one unit of depth in metres, such as 0.001 for millimetres. Files of "
        "integers need it. Files of floating-point numbers are taken to be in metres without "
        "it."),
    "--size": (size,
        "The width and height of the depth map in pixels, such as 1032x772. It is needed for "
        "PLY point clouds that do not state it."),
    "--ray-length": (None,
        "State that depth is the distance from the camera along the ray of each pixel, as laser "
        "scanners and some renderers give it. It is converted to z."),
    "--rgb": (Path, "The colour pictures, one for each depth map in the same order."),
    "--unit": (tuple(UNITS_M),
        "The unit of the lengths in the file. It is needed only if the file does not make it "
        "clear."),
    "--board": (str,
        "The board: chessboard:9x6:0.025 states the numbers of squares and their side in metres; "
        "charuco:8x5:0.03:0.022:DICT_5X5_100 adds the side of the markers and their dictionary. "
        "Add :legacy at the end for a ChArUco board in the layout of OpenCV before 4.6."),
    "--simulate": (whole,
        "The number of simulations: of the labels of each scene with physics, or of calibrations "
        "with noise."),
    "--near": (length_m, "The nearest working distance in metres."),
    "--far": (length_m, "The farthest working distance in metres."),
}  # fmt: skip


def add_option(
    parser: argparse.ArgumentParser,
    name: str,
    kind: Kind,
    help: str,
    default: object = None,
    *,
    usual: str | None = None,
    **more: Any,
) -> None:
    """Add an option, or an argument without dashes.

    Args:
        kind: a function that converts the text, a tuple of choices, or None for a switch.
        usual: a text that describes the default, if the value itself would not.
        more: further arguments of `add_argument`.
    """
    usual = str(default) if usual is None and default is not None else usual
    if usual is not None:
        help = f"{help.removesuffix('.')} (default: {usual})."
    if kind is None:
        parser.add_argument(name, action="store_true", help=help)
    elif isinstance(kind, tuple):
        parser.add_argument(name, choices=kind, default=default, help=help, **more)
    else:
        if name.startswith("-"):
            more.setdefault("metavar", _METAVARS.get(name) or _METAVARS.get(kind))
        parser.add_argument(name, type=kind, default=default, help=help, **more)


def add_shared(
    parser: argparse.ArgumentParser,
    *names: str,
    default: object = None,
    usual: str | None = None,
    **more: Any,
) -> None:
    """Add options from the table of shared flags."""
    for name in names:
        kind, help = SHARED[name]
        add_option(parser, name, kind, help, default, usual=usual, **more)


def add_out(parser: argparse.ArgumentParser, help: str, *, required: bool = True) -> None:
    """Add the option `--out`, the folder or the file that a command writes."""
    add_option(parser, "--out", Path, help, required=required)


def add_png(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add the option `--out`, the PNG picture that a command writes."""
    add_option(
        parser, "--out", png_path, "The PNG file to write.", required=required, metavar="PATH"
    )


def add_config(parser: argparse.ArgumentParser) -> None:
    help = "The YAML file of the configuration. The folder configs/ has examples."
    add_option(parser, "config", Path, help)


def add_device(parser: argparse.ArgumentParser) -> None:
    add_shared(parser, "--device", default="auto")


def add_rig(parser: argparse.ArgumentParser, *, flag: bool = False) -> None:
    """Add the argument `rig`, or with `flag` the option `--rig`, and add `--resolution`."""
    if flag:
        add_shared(parser, "--rig", required=True)
    else:
        add_option(parser, "rig", *SHARED["--rig"])
    add_shared(parser, "--resolution", usual="low")


def add_division(parser: argparse.ArgumentParser, *, shares: str | None, usual: str = "") -> None:
    """Add the options that divide a dataset into sets; `usual` describes the default division."""
    add_shared(parser, "--shares", default=shares, usual=usual or None)
    add_shared(parser, "--split-seed", default=0)


def add_scoring(parser: argparse.ArgumentParser, *, split: str) -> None:
    """Add the options for scores against a dataset; `split` describes the default set."""
    add_shared(parser, "--on", required=True)
    add_out(parser, "The folder to write.")
    add_shared(parser, "--split", usual=split)
    add_division(parser, shares=None, usual="the division with which the results were made")
    add_shared(parser, "--min-visibility", default=0.1)
    add_shared(parser, "--resamples", default=1000)
    add_shared(parser, "--seed", default=0)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the options for worker processes, which `workers_of` reads."""
    many = "1; with --engine ray, as many as the cluster has room for"
    add_shared(parser, "--workers", usual=many)
    threads = "those of this machine, divided equally; with --engine ray, 1"
    add_shared(parser, "--threads", usual=threads)
    add_shared(parser, "--engine", default="local")
    add_shared(parser, "--address", usual="a Ray instance on this machine")


# --- meaning of options ---------------------------------------------------------------------------


def workers_of(options: argparse.Namespace) -> "Workers":
    """Return the workers that the options of `add_workers` describe.

    Raises:
        GraycastError: `--address` is given without `--engine ray`.
    """
    from ..cell.engine import Workers

    if options.address is not None and options.engine != "ray":
        raise GraycastError(
            "--address applies only to a Ray cluster: add --engine ray, or remove --address"
        )
    return Workers(
        engine=options.engine,
        count=options.workers or (1 if options.engine == "local" else 0),
        threads=options.threads,
        address=options.address,
    )


def division_of(options: argparse.Namespace):
    """Return the division of the dataset by `--shares`; None if this option is not given."""
    from ..dataset.export import Split, parse_shares

    if options.shares is None and options.split_seed:
        raise GraycastError(
            "--split-seed applies only with --shares: add --shares, or remove --split-seed"
        )
    if options.shares is None:
        return None
    return Split(shares=parse_shares(options.shares), seed=options.split_seed)


def resolve_rig_option(options: argparse.Namespace):
    """Return the scanner for the arguments `rig` and `--resolution`."""
    from ..camera.rig_file import named_scanner

    own_file = options.rig not in PRESETS and Path(options.rig).is_file()
    if options.resolution is not None and own_file:
        raise GraycastError(
            f"--resolution applies only to a preset, and the rig file {options.rig} states its "
            "own resolution: remove --resolution"
        )
    return named_scanner(options.rig, folder=Path(), resolution=options.resolution or "low")


def cell_of(options: argparse.Namespace):
    """Return the cell for `config` and `--backend`, and print the cell's notes."""
    from ..cell.config import load_config

    if not options.config.exists():
        raise GraycastError(
            f"{options.config}: no such file: check the path, or write a configuration with "
            "'graycast new'; 'graycast demo' needs none"
        )
    config = load_config(options.config)
    if getattr(options, "backend", None) is not None:
        render = config.render.model_copy(update={"backend": options.backend})
        config = config.model_copy(update={"render": render})
    return resolve_config(config, options.config, options.config.parent)


def resolve_config(config, name: Path, folder: Path):
    """Return a cell whose relative paths start in `folder`; errors begin with `name`."""
    from ..cell.resolve import resolve_cell

    try:
        with open_stages() as progress:
            cell = resolve_cell(config, folder, progress=progress)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{name}: {error}") from error
    for note in cell.notes:
        print(f"note: {note}")
    return cell


def file_options(options: argparse.Namespace) -> "FileOptions":
    """Return the values of the options for depth files, from `--intrinsics` to `--max-depth`."""
    from ..real.depth_file import FileOptions, read_intrinsics

    return FileOptions(
        K=None if options.intrinsics is None else read_intrinsics(options.intrinsics),
        distortion=getattr(options, "distortion", None),
        scale_m=options.scale,
        size_px=options.size,
        ray_length=getattr(options, "ray_length", False),
        max_depth_m=getattr(options, "max_depth", None),
    )


def failed_line(name: str, failed: "Failed", *, if_final: str = "given up") -> str:
    """Return a line with the reason of a failure, and whether the same run tries again."""
    then = if_final if failed.final else "will be made again"
    return f"{name}  {then}: {one_line(failed.error)}"


def print_missing(names: Iterable[str]) -> None:
    """Print a line for each scene or bin that a run could not make."""
    for name in names:
        print(f"  {name} is missing; run the same command again to retry it")


def print_shares(of_parts: Mapping[str, float], of_all: Mapping[str, float]) -> None:
    """Print the share of pixels for each reason: first among the parts' pixels, then among all."""
    for name, part_of_all in of_all.items():
        first = f"{of_parts[name]:7.2%} of the parts' pixels, " if of_parts else ""
        print(f"  {name:18} {first}{part_of_all:7.2%} of all pixels")
