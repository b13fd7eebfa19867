"""Commands of robots: pick, picks, replay."""

import argparse
from pathlib import Path

from ..errors import GraycastError
from .arguments import (
    above_zero,
    add_command,
    add_device,
    add_seed,
    add_workers,
    positive,
    progress_bar,
    stage_line,
    workers_of,
)

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PICK = """\
Let a simulated robot empty bins. Each bin is filled by physics, scanned, and emptied part by part;
every attempt ends in one of a closed list of outcomes, with a picture. The same command goes on
where it was stopped: a bin depends on the configuration, the seed and its number alone. The robot
needs pip install 'graycast[pick]'."""

PICKS = """\
Tell what became of picks: success rate with its 95 % interval (Wilson), outcomes, bins cleared,
picks per hour, seconds by stage. Further folders of the same bins, made with another detector or
another kind of depth, are set beside the first one in a table, and McNemar's test says whether
they differ from it."""


REPLAY = """\
Make a film of how a bin was emptied, one attempt after the other: the robot over what the scanner
measured, the part that it takes, and the outcome. To look closer, make a page with graycast report.
The robot needs pip install 'graycast[pick]'."""


def add_commands(commands) -> None:
    pick = add_command(commands, "pick", _pick, "Let a simulated robot empty bins.")
    pick.description = PICK
    pick.set_defaults(when_stopped="finished bins are kept")
    pick.add_argument("config", type=Path, help="The robot's cell, a YAML file.")
    pick.add_argument("--out", type=Path, required=True, help="The folder of picks.")
    pick.add_argument(
        "--bins", type=positive, default=3, help="How many bins are to be emptied (default: 3)."
    )
    add_seed(pick)
    add_device(pick)
    pick.add_argument(
        "--detector",
        help="What finds the parts, instead of the configuration's: truth, none, or the folder of "
        "a training.",
    )
    pick.add_argument(
        "--pose", choices=("found", "truth"), help="Where a part's pose comes from, likewise."
    )
    pick.add_argument(
        "--depth",
        metavar="KIND",
        help="What the robot acts on, likewise: scanner, perfect, or a standard deviation of "
        "Gaussian noise on perfect depth in metres, such as 0.0002.",
    )
    add_workers(pick, "bins are emptied")
    picks = add_command(commands, "picks", _picks, "Tell what became of picks, and compare runs.")
    picks.description = PICKS
    picks.add_argument("folders", type=Path, nargs="+", help="Folders of picks.")
    replay = add_command(commands, "replay", _replay, "Make a film of how a bin was emptied.")
    replay.description = REPLAY
    replay.add_argument("folder", type=Path, help="A folder of picks.")
    replay.add_argument("--bin", type=int, default=0, help="The number of the bin (default: 0).")
    replay.add_argument("--out", type=Path, required=True, help="The film, a GIF or WebP file.")
    replay.add_argument(
        "--speed",
        type=above_zero,
        default=2.0,
        help="How much faster than the robot the film runs (default: 2).",
    )
    replay.add_argument("--width", type=positive, help="The film's width in pixels (default: 480).")
    add_cell(replay)


def add_cell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cell",
        type=Path,
        help="The cell's file that the picks were made of. Needed where it names files.",
    )


def cell_folder(options: argparse.Namespace) -> Path:
    """Where the relative paths of the cell of picks start."""
    return Path.cwd() if options.cell is None else options.cell.absolute().parent


def need_robot() -> None:
    """Raises GraycastError: the robot's libraries are not installed."""
    try:
        import pinocchio  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "a robot needs its libraries: run pip install 'graycast[pick]'"
        ) from error


def _pick(options: argparse.Namespace) -> int:
    need_robot()
    from ..pick import load_pick_config, pick_bins, read_episodes, resolve_pick_cell, summarize

    workers = workers_of(options)
    config = _with_options(load_pick_config(options.config), options)
    try:
        with stage_line() as on_stage:
            cell = resolve_pick_cell(config, options.config.parent, on_stage=on_stage)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    seed = config.seed if options.seed is None else options.seed
    names = ", ".join(part.name for part in cell.cell.scene.parts)
    print(
        f"{options.bins} bins of {names}, {config.robot.arm} with {config.tool.kind}, rig "
        f"{cell.cell.scene.rig.name}, seed {seed}"
    )
    with progress_bar() as bar:
        bins = bar.add_task("bins", total=options.bins)
        stage = bar.add_task("", total=None, visible=False)

        def made(outcome) -> None:
            bar.update(bins, advance=1)
            ended = ", ".join(f"{int(n)} {name}" for name, n in outcome.reasons.items())
            bar.console.print(f"bin {outcome.scene_id:06d}  {outcome.seconds:6.1f} s  {ended}")

        def failed(outcome) -> None:
            told = " ".join(str(outcome.error).split()) or type(outcome.error).__name__
            bar.console.print(f"bin {outcome.scene_id:06d}  failed: {told}", markup=False)

        lost = pick_bins(
            cell,
            options.out,
            bins=options.bins,
            seed=seed,
            device=options.device,
            workers=workers,
            on_start=lambda found: bar.update(bins, completed=found),
            on_made=made,
            on_failed=failed,
            on_stage=lambda text: bar.reset(stage, description=text, total=None, visible=True),
        )
    _tell(summarize(read_episodes(options.out)))
    print(f"{options.out}: pictures of every attempt are in bins/*/pictures")
    return 1 if lost else 0


def _with_options(config, options: argparse.Namespace):
    """The configuration with what the command line says instead, checked as a file is."""
    from ..pick.sections import PickConfig

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
    told = config.model_dump(mode="json")
    return PickConfig.model_validate(told | {"picking": told["picking"] | changed})


def _depth(text: str) -> dict[str, object]:
    if text in ("scanner", "perfect"):
        return {"depth": text, "depth_noise_m": None}
    try:
        return {"depth": "noisy", "depth_noise_m": float(text)}
    except ValueError:
        raise GraycastError(
            f"--depth is {text!r}: give scanner, perfect, or a number of metres"
        ) from None


def _picks(options: argparse.Namespace) -> int:
    from ..pick import compared, read_episodes, summarize

    episodes = [read_episodes(folder) for folder in options.folders]
    _tell(summarize(episodes[0]))
    if len(episodes) > 1:
        names = [str(folder) for folder in options.folders]
        print(f"\n{compared(dict(zip(names, episodes, strict=True)))}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    need_robot()
    from ..report.picks.film import WIDTH_PX, write_film

    with progress_bar() as bar:
        task = bar.add_task("attempts", total=None)
        count = write_film(
            options.folder,
            options.bin,
            options.out,
            cell_folder=cell_folder(options),
            speed=options.speed,
            width_px=options.width or WIDTH_PX,
            on_start=lambda total: bar.update(task, total=total),
            on_attempt=lambda: bar.update(task, advance=1),
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
        f"{summary.bins} bins, {summary.cleared} cleared; of {summary.filled} parts "
        f"{summary.taken} taken, {summary.left} left, {summary.spilled} spilled"
    )
    for name, count in summary.outcomes.items():
        print(f"  {name:18} {count:6d}")
    attempts = sum(summary.outcomes.values())
    print(
        f"an attempt takes {summary.seconds['scan'] / attempts:.2f} s to scan, "
        f"{summary.thinking_s:.2f} s to think on this machine (median), "
        f"{summary.seconds['motion'] / attempts:.2f} s to move: "
        f"{summary.picks_per_hour:.0f} picks an hour"
    )
