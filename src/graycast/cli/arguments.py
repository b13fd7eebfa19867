"""What the commands' arguments have in common."""

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..errors import GraycastError
from ..rig import PRESETS, RESOLUTIONS

if TYPE_CHECKING:
    from ..generate import Workers

Run = Callable[[argparse.Namespace], int | None]


def add_command(into, name: str, run: Run, help: str) -> argparse.ArgumentParser:
    """A parser for one command among others."""
    made = into.add_parser(name, help=help, description=help)
    made.add_argument(
        "--debug", action="store_true", help="Show where in the program an error arose."
    )
    made.set_defaults(run=run, when_stopped="nothing was written")
    return made


def add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "config", type=Path, help="The configuration, a YAML file; configs/ has examples."
    )


def add_seed(parser: argparse.ArgumentParser, default: int | None = None) -> None:
    told = "as configured" if default is None else default
    parser.add_argument(
        "--seed",
        type=seed,
        default=default,
        help=f"Another seed draws everything random anew (default: {told}).",
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda", "optix"),
        default="auto",
        help="Where to render; auto takes the GPU where it works, else the CPU, and only Cycles "
        "knows optix (default: auto).",
    )


def add_backend(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    told = "as configured" if default is None else default
    parser.add_argument(
        "--backend",
        choices=("mitsuba", "cycles"),
        default=default,
        help="The renderer; mitsuba renders all patterns in one pass, cycles each by itself "
        f"(default: {told}).",
    )


def add_rig(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("rig", help=f"The rig: a rig file, or one of {', '.join(PRESETS)}.")
    add_resolution(parser)


def add_resolution(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--resolution",
        choices=RESOLUTIONS,
        help="The size of a preset's pictures; a rig file has its own (default: low).",
    )


def resolve_rig_option(options: argparse.Namespace):
    """The scanner that `rig` and `--resolution` mean."""
    from ..rig_file import named_scanner

    if options.resolution is not None and options.rig not in PRESETS:
        raise GraycastError(
            f"--resolution is of a preset; {options.rig} has its own sizes: leave it out"
        )
    return named_scanner(options.rig, folder=Path(), resolution=options.resolution or "low")


def load_cell(options: argparse.Namespace):
    """The cell of `config`, with the back end that was asked for; notes on its meshes are told."""
    from ..config import load_config

    return resolve_cell_option(load_config(options.config), options)


def resolve_cell_option(config, options: argparse.Namespace):
    """The cell of a configuration whose relative paths start where the file `options.config` is."""
    from ..cell import resolve_cell

    if getattr(options, "backend", None) is not None:
        render = config.render.model_copy(update={"backend": options.backend})
        config = config.model_copy(update={"render": render})
    try:
        with stage_line() as on_stage:
            cell = resolve_cell(config, options.config.parent, on_stage=on_stage)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    for note in cell.notes:
        print(f"note: {note}")
    return cell


def positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def counts(text: str) -> tuple[int, ...]:
    return tuple(positive(number) for number in text.split(","))


def above_zero(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share from 0 to 1")
    return value


def size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(width), int(height)


def add_scanner_files(
    parser: argparse.ArgumentParser, *, intrinsics: str = "", distortion: str | None = None
) -> None:
    """What depth files of a scanner do not say themselves.

    Args:
        intrinsics: what the help says of its default.
        distortion: the same; None where the command does not ask for it.
    """
    parser.add_argument(
        "--intrinsics",
        metavar="K",
        help=f"The camera's intrinsics: fx,fy,cx,cy or a file that holds K{intrinsics}.",
    )
    if distortion is not None:
        parser.add_argument(
            "--distortion",
            metavar="D",
            help=f"The lens's distortion: k1,k2,p1,p2,k3 as OpenCV has them{distortion}.",
        )
    parser.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="How many metres one unit of depth is: 0.001 for millimetres. Files of integers need "
        "it; floats are metres without it.",
    )
    parser.add_argument(
        "--size",
        type=size,
        metavar="WxH",
        help="The width and height in pixels of PLY clouds that do not state it.",
    )


def intrinsics_of(options: argparse.Namespace) -> Float[np.ndarray, "3 3"] | None:
    """K, if `--intrinsics` says it."""
    from ..real.depth_file import read_intrinsics

    return None if options.intrinsics is None else read_intrinsics(options.intrinsics)


def distortion_of(options: argparse.Namespace) -> tuple[float, float, float, float, float] | None:
    """The five terms, if `--distortion` says them."""
    text = options.distortion
    if text is None:
        return None
    try:
        k1, k2, p1, p2, k3 = (float(word) for word in text.split(","))
    except ValueError as error:
        raise GraycastError(f"distortion is {text!r}: give five numbers k1,k2,p1,p2,k3") from error
    return k1, k2, p1, p2, k3


def add_workers(parser: argparse.ArgumentParser, done: str) -> None:
    """Options of who does the work; `done` says what one of them does at a time.

    `workers_of` reads them.
    """
    parser.add_argument(
        "--workers",
        type=positive,
        help=f"How many {done} at a time (default: 1; with ray as many as the cluster has room "
        "for).",
    )
    parser.add_argument(
        "--threads",
        type=positive,
        help="How many processor threads each worker uses (default: all of this machine, shared "
        "out; with ray 1).",
    )
    parser.add_argument(
        "--engine",
        choices=("local", "ray"),
        default="local",
        help="Workers are processes of this machine (local) or of a Ray cluster, which needs "
        "pip install 'graycast[ray]' (default: local).",
    )
    parser.add_argument(
        "--address", help="The Ray cluster's address, host:port (default: Ray on this machine)."
    )


def workers_of(options: argparse.Namespace) -> "Workers":
    """Who does the work.

    Raises:
        GraycastError: an address is given, and no cluster is asked for.
    """
    from ..generate import Workers

    if options.address is not None and options.engine != "ray":
        raise GraycastError("--address is of a Ray cluster: add --engine ray, or leave it out")
    return Workers(
        engine=options.engine,
        count=options.workers or (1 if options.engine == "local" else 0),
        threads=options.threads,
        address=options.address,
    )


@contextmanager
def stage_line() -> Iterator[Callable[[str], None]]:
    """A line that shows what is being done, and for how long; it is gone at the end."""
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("", total=None, visible=False)
        yield lambda stage: bar.reset(task, description=escape(stage), total=None, visible=True)


def progress_bar():
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
