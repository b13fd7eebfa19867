"""Arguments that several commands share."""

import argparse
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..base.errors import GraycastError
from ..rig.pair import PRESETS, RESOLUTIONS
from .bars import open_stages

if TYPE_CHECKING:
    from ..cell.engine import Workers

Run = Callable[[argparse.Namespace], int | None]


def add_command(into, name: str, run: Run, help: str) -> argparse.ArgumentParser:
    """Add a command and return its parser."""
    command = into.add_parser(name, help=help, description=help)
    command.add_argument(
        "--debug",
        action="store_true",
        help="Print the Python traceback of an error, not only its message.",
    )
    command.set_defaults(run=run, when_stopped="nothing was written")
    return command


def add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "config",
        type=Path,
        help="The YAML file of the configuration. The folder configs/ has examples.",
    )


def add_seed(parser: argparse.ArgumentParser, default: int | None = None) -> None:
    default_text = "as configured" if default is None else default
    parser.add_argument(
        "--seed",
        type=seed,
        default=default,
        help="The seed of all random numbers. The same seed gives the same result (default: "
        f"{default_text}).",
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda", "optix"),
        default="auto",
        help="The device that renders. auto uses the GPU if it works and the CPU otherwise; "
        "optix is for Cycles only (default: auto).",
    )


def add_backend(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    default_text = "as configured" if default is None else default
    parser.add_argument(
        "--backend",
        choices=("mitsuba", "cycles"),
        default=default,
        help="The renderer. mitsuba renders all patterns in one pass; cycles renders them "
        f"one after the other (default: {default_text}).",
    )


def add_rig(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "rig", help=f"The rig: a path to a rig file, or the name of a preset: {', '.join(PRESETS)}."
    )
    add_resolution(parser)


def add_resolution(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--resolution",
        choices=RESOLUTIONS,
        help="The resolution of a preset's pictures. A rig file states its own resolution, "
        "so this option is refused with one (default: low).",
    )


def resolve_rig_option(options: argparse.Namespace):
    """Return the scanner that the arguments `rig` and `--resolution` name."""
    from ..camera.rig_file import named_scanner

    if options.resolution is not None and options.rig not in PRESETS:
        raise GraycastError(
            f"--resolution applies only to a preset, and the rig file {options.rig} states its "
            "own resolution: remove --resolution"
        )
    return named_scanner(options.rig, folder=Path(), resolution=options.resolution or "low")


def load_cell(options: argparse.Namespace):
    """Load the cell of `config` with the renderer of `--backend`; print its notes."""
    from ..cell.config import load_config

    if not options.config.exists():
        raise GraycastError(
            f"{options.config}: no such file: check the path, or write a configuration with "
            "'graycast new'; 'graycast demo' needs none"
        )
    return resolve_cell_option(load_config(options.config), options)


def resolve_cell_option(config, options: argparse.Namespace):
    """Build a cell; relative paths start in the folder of `options.config`."""
    from ..cell.resolve import resolve_cell

    if getattr(options, "backend", None) is not None:
        render = config.render.model_copy(update={"backend": options.backend})
        config = config.model_copy(update={"render": render})
    try:
        with open_stages() as progress:
            cell = resolve_cell(config, options.config.parent, progress=progress)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    for note in cell.notes:
        print(f"note: {note}")
    return cell


def positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def above_zero(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number greater than 0")
    return value


def seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to 1")
    return value


def size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(width), int(height)


def add_scanner_files(
    parser: argparse.ArgumentParser, *, intrinsics: str = "", distortion: str | None = None
) -> None:
    """Add the options for what a scanner's depth files do not state themselves.

    Args:
        intrinsics: the words that the help of `--intrinsics` adds about its default.
        distortion: the same for `--distortion`; None for a command without that option.
    """
    parser.add_argument(
        "--intrinsics",
        metavar="K",
        help="The camera's intrinsics in pixels: the four numbers fx,fy,cx,cy, or a file "
        f"that holds the camera matrix K{intrinsics}.",
    )
    if distortion is not None:
        parser.add_argument(
            "--distortion",
            metavar="D",
            help="The distortion coefficients of the lens in OpenCV's order: "
            f"k1,k2,p1,p2,k3{distortion}.",
        )
    parser.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="The length of one unit of depth in metres, such as 0.001 for millimetres. "
        "Files of integers need it. Files of floating-point numbers are taken to be in "
        "metres without it.",
    )
    parser.add_argument(
        "--size",
        type=size,
        metavar="WxH",
        help="The width and height of the depth map in pixels, such as 1032x772. It is "
        "needed for PLY point clouds that do not state it.",
    )


def intrinsics_of(options: argparse.Namespace) -> Float[np.ndarray, "3 3"] | None:
    """The camera matrix of `--intrinsics`; None without that option."""
    from ..real.depth_file import read_intrinsics

    return None if options.intrinsics is None else read_intrinsics(options.intrinsics)


def distortion_of(options: argparse.Namespace) -> tuple[float, float, float, float, float] | None:
    """The five coefficients of `--distortion`; None without that option."""
    text = options.distortion
    if text is None:
        return None
    try:
        k1, k2, p1, p2, k3 = (float(word) for word in text.split(","))
    except ValueError as error:
        raise GraycastError(
            f"--distortion is {text!r}: give the five numbers k1,k2,p1,p2,k3, separated by commas"
        ) from error
    return k1, k2, p1, p2, k3


def add_workers(parser: argparse.ArgumentParser, done: str) -> None:
    """Add the options for workers; `done` completes the sentence "How many ... at the same time".

    `workers_of` reads them.
    """
    parser.add_argument(
        "--workers",
        type=positive,
        help=f"How many {done} at the same time (default: 1; with --engine ray, as many as "
        "the cluster has room for).",
    )
    parser.add_argument(
        "--threads",
        type=positive,
        help="The number of processor threads of each worker (default: the threads of this "
        "machine, divided equally among the workers; with --engine ray, 1).",
    )
    parser.add_argument(
        "--engine",
        choices=("local", "ray"),
        default="local",
        help="Where the workers run: local starts processes on this machine; ray uses a Ray "
        "cluster and needs pip install 'graycast[ray]' (default: local).",
    )
    parser.add_argument(
        "--address",
        help="The address of the Ray cluster as host:port. It needs --engine "
        "ray (default: a Ray instance on this machine).",
    )


def workers_of(options: argparse.Namespace) -> "Workers":
    """Read the options that `add_workers` added.

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


def print_shares(of_parts: Mapping[str, float], of_all: Mapping[str, float]) -> None:
    """A line for each reason, the parts' pixels first."""
    for name, share in of_all.items():
        first = f"{of_parts[name]:7.2%} of the parts' pixels, " if of_parts else ""
        print(f"  {name:18} {first}{share:7.2%} of all pixels")
