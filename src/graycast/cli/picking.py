"""Commands of robots: pick, picks, replay."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError, one_line
from .arguments import (
    above_zero,
    add_command,
    add_device,
    add_seed,
    add_workers,
    positive,
    workers_of,
)
from .bars import open_bars, open_stages

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PICK = """\
Let a simulated robot empty bins. Each bin is filled by a physics simulation and scanned, and
the robot then removes part after part. Each attempt is recorded with one outcome of a fixed
list and with a picture. If the command is stopped, the same command continues it, because a bin
depends only on the configuration, the seed and the number of the bin. The robot needs pip
install 'graycast[pick]'."""

PICKS = """\
Summarise picks: the success rate with its 95 % confidence interval (Wilson), the outcomes, the
number of cleared bins, the picks per hour, and the seconds of each stage. Further folders may
hold picks from the same bins with another detector or another kind of depth. The command compares
them with the first folder in a table, and McNemar's test tells whether they differ significantly
from it."""


REPLAY = """\
Make a film of how the robot emptied a bin, one attempt after the other. It shows the robot
above the measured point cloud, the part that it picks, and the outcome. For an interactive
view, make a page with graycast report. The robot needs pip install 'graycast[pick]'."""


def add_commands(commands) -> None:
    pick = add_command(commands, "pick", _pick, "Let a simulated robot empty bins.")
    pick.description = PICK
    pick.set_defaults(
        when_stopped="the finished bins are kept; run the same command again to continue"
    )
    pick.add_argument(
        "config",
        type=Path,
        help="The YAML file of the robot cell, such as configs/cells/ur5e_suction.yaml.",
    )
    pick.add_argument(
        "--out", type=Path, required=True, help="The folder to which the picks are written."
    )
    pick.add_argument(
        "--bins", type=positive, default=3, help="The number of bins to empty (default: 3)."
    )
    add_seed(pick)
    add_device(pick)
    pick.add_argument(
        "--detector",
        help="The detector: truth, none, or a folder that graycast train wrote (default: as "
        "configured).",
    )
    pick.add_argument(
        "--pose",
        choices=("found", "truth"),
        help="The source of the pose of a part (default: as configured).",
    )
    pick.add_argument(
        "--depth",
        metavar="KIND",
        help="The depth that the robot uses: scanner, perfect, or a number such as 0.0002, "
        "which is the standard deviation in metres of Gaussian noise on perfect depth "
        "(default: as configured).",
    )
    add_workers(pick, "bins are emptied")
    picks = add_command(
        commands, "picks", _picks, "Summarise the outcomes of picks, and compare several runs."
    )
    picks.description = PICKS
    picks.add_argument("folders", type=Path, nargs="+", help="Folders that graycast pick wrote.")
    picks.add_argument(
        "--plot",
        type=Path,
        help="The PNG file to write, in which the rates, the failures and the parts that are "
        "left are drawn for each folder.",
    )
    replay = add_command(commands, "replay", _replay, "Make a film of how the robot emptied a bin.")
    replay.description = REPLAY
    replay.add_argument("folder", type=Path, help="A folder that graycast pick wrote.")
    replay.add_argument(
        "--bin", type=int, default=0, help="The number of the bin, counted from 0 (default: 0)."
    )
    replay.add_argument("--out", type=Path, required=True, help="The GIF or WebP file to write.")
    replay.add_argument(
        "--speed",
        type=above_zero,
        default=2.0,
        help="The speed of the film relative to the robot's motion (default: 2).",
    )
    replay.add_argument(
        "--width", type=positive, help="The width of the film in pixels (default: 480)."
    )
    add_cell(replay)


def add_cell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cell",
        type=Path,
        help="The configuration of the cell that made the picks. It is needed only if it "
        "names files by relative paths.",
    )


def cell_folder(options: argparse.Namespace) -> Path:
    """The folder in which the relative paths of the picks' cell start."""
    return Path.cwd() if options.cell is None else options.cell.absolute().parent


def need_robot() -> None:
    """Raise GraycastError if the robot's libraries are not installed."""
    try:
        import pinocchio  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "the robot needs libraries that are not installed: run pip install 'graycast[pick]'"
        ) from error


def _pick(options: argparse.Namespace) -> int:
    need_robot()
    from ..robot.pick import (
        load_pick_config,
        pick,
        read_episodes,
        resolve_pick_cell,
        summarize,
    )

    workers = workers_of(options)
    config = _with_options(load_pick_config(options.config), options)
    try:
        with open_stages() as progress:
            cell = resolve_pick_cell(config, options.config.parent, progress=progress)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    seed = config.seed if options.seed is None else options.seed
    names = ", ".join(part.name for part in cell.cell.scene.parts)
    print(
        f"{_bins(options.bins)} of {names}, {config.robot.arm} with {config.tool.kind}, rig "
        f"{cell.cell.scene.rig.name}, seed {seed}"
    )
    with open_bars() as bars:

        def report(outcome) -> None:
            ended = ", ".join(f"{int(n)} {name}" for name, n in outcome.reasons.items())
            bars.line(f"bin {outcome.scene_id:06d}  {outcome.seconds:6.1f} s  {ended}")

        def failed(outcome) -> None:
            bars.line(f"bin {outcome.scene_id:06d}  failed: {one_line(outcome.error)}")

        lost = pick(
            cell,
            options.out,
            bins=options.bins,
            seed=seed,
            device=options.device,
            workers=workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    _tell(summarize(read_episodes(options.out)))
    print(f"{options.out}: the pictures of all attempts are in bins/*/pictures")
    return 1 if lost else 0


def _with_options(config, options: argparse.Namespace):
    """The configuration with the options of the command line, checked like a file."""
    from ..robot.pick.pick_sections import PickConfig

    changed = {}
    if options.detector is not None:
        named = options.detector in ("truth", "none")
        changed["detector"] = options.detector if named else str(Path(options.detector).absolute())
    if options.pose is not None:
        changed["pose"] = options.pose
    if options.depth is not None:
        changed |= _depth(options.depth)
    if not changed:
        return config
    settings = config.model_dump(mode="json")
    return PickConfig.model_validate(settings | {"picking": settings["picking"] | changed})


def _depth(text: str) -> dict[str, object]:
    if text in ("scanner", "perfect"):
        return {"depth": text, "depth_noise_m": None}
    try:
        return {"depth": "noisy", "depth_noise_m": float(text)}
    except ValueError:
        raise GraycastError(
            f"--depth is {text!r}: give scanner, perfect, or a number of metres"
        ) from None


def _bins(count: int) -> str:
    return "1 bin" if count == 1 else f"{count} bins"


def _picks(options: argparse.Namespace) -> int:
    from ..robot.pick import compared, plot_runs, read_episodes, summarize

    runs = {str(folder): read_episodes(folder) for folder in options.folders}
    _tell(summarize(next(iter(runs.values()))))
    if len(runs) > 1:
        print(f"\n{compared(runs)}")
    if options.plot is not None:
        summaries = {name: summarize(episodes) for name, episodes in runs.items()}
        plot_runs(summaries, options.plot)
        print(f"{options.plot}: a row for each of {len(summaries)} folders")
    return 0


def _replay(options: argparse.Namespace) -> int:
    need_robot()
    from ..show.report.picks.film import WIDTH_PX, write_film

    with open_bars() as bars:
        count = write_film(
            options.folder,
            options.bin,
            options.out,
            cell_folder=cell_folder(options),
            speed=options.speed,
            width_px=options.width or WIDTH_PX,
            progress=bars,
        )
    size_mb = options.out.stat().st_size / 1e6
    print(f"{options.out}: {count} pictures, {size_mb:.1f} MB")
    return 0


def _tell(summary) -> None:
    rate, low, high = summary.rate
    print(
        f"{summary.picked} of {summary.grips} grips took a part out: {rate:.1%} "
        f"(95 % interval {low:.1%} to {high:.1%})"
    )
    print(
        f"{_bins(summary.bins)}, {summary.cleared} cleared; of {summary.filled} parts "
        f"{summary.taken} taken, {summary.left} left, {summary.spilled} spilled"
    )
    for name, count in summary.outcomes.items():
        print(f"  {name:18} {count:6d}")
        if name == "nothing found":
            for detail, times in summary.missing.items():
                print(f"    {times} times {detail}")
    attempts = sum(summary.outcomes.values())
    print(
        f"an attempt takes {summary.seconds['scan'] / attempts:.2f} s to scan, "
        f"{summary.thinking_s:.2f} s to think on this machine (median), "
        f"{summary.seconds['motion'] / attempts:.2f} s to move: "
        f"{summary.picks_per_hour:.0f} picks an hour"
    )
