"""Commands for robots: robot pick, summary, report, score-poses."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import (
    CONTINUE,
    add_command,
    add_device,
    add_group,
    add_option,
    add_out,
    add_png,
    add_scoring,
    add_shared,
    add_workers,
    division_of,
    failed_line,
    print_missing,
    workers_of,
)
from .bars import open_bars, open_stages
from .readers import positive
from .scene_commands import WIDTH_PX

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PICK = """\
Each bin is filled by a physics simulation and scanned, and the robot then removes part after part.
Each attempt is recorded with one outcome of a fixed list and with a picture. If the command is
stopped, the same command continues it, because a bin depends only on the configuration, the seed
and the number of the bin. The robot needs pip install 'graycast[pick]'."""

SUMMARY = """\
The summary has the success rate with its 95 % confidence interval (Wilson), the outcomes, the
number of cleared bins, the picks per hour, and the seconds of each stage. Further folders may hold
picks from the same bins with another detector or another kind of depth. The command compares them
with the first folder in a table, and McNemar's test tells whether they differ significantly from
it. With --out, the command draws the rates, the failures and the parts that are left."""


def add_commands(commands) -> None:
    group = add_group(commands, "robot", "Let robots empty bins, and summarise and show the picks.")
    _add_pick(group)
    picks = "A folder that graycast robot pick wrote."
    summary = add_command(
        group, "summary", _summary, "Summarise the outcomes of picks, and compare several runs.",
        example="out/picks", more=SUMMARY,
    )  # fmt: skip
    add_option(summary, "picks", Path, "Folders that graycast robot pick wrote.", nargs="+")
    add_png(summary)

    report = add_command(
        group, "report", _report, "Write a web page of picks.",
        example="out/picks --out out/page", more="A browser opens the page from the disk.",
        when_stopped=f"the finished bins are kept; {CONTINUE}",
    )  # fmt: skip
    add_option(report, "picks", Path, picks)
    add_out(report, "The folder to write.")
    add_shared(report, "--workers", default=1)
    add_shared(report, "--width", default=WIDTH_PX)
    add_shared(report, "--files", default=Path(), usual="the current folder")

    score = add_command(
        group, "score-poses", _score_poses, "Score poses against the labels of a dataset.",
        example="poses.csv --on out/demo --out out/scores",
        more="Each score has a confidence interval.",
    )  # fmt: skip
    add_option(score, "results", Path, "A CSV file of BOP results with poses.")
    add_scoring(score, split="train, which holds all scenes of a dataset that is not divided")


def _add_pick(group) -> None:
    pick = add_command(
        group, "pick", _pick, "Let a simulated robot empty bins.",
        example="configs/cells/ur5e_suction.yaml --out out/picks", more=PICK,
        when_stopped=f"the finished bins are kept; {CONTINUE}",
    )  # fmt: skip
    file = "The YAML file of the robot cell, such as configs/cells/ur5e_suction.yaml."
    add_option(pick, "config", Path, file)
    add_out(pick, "The folder to write.")
    add_option(pick, "--bins", positive, "The number of bins to empty.", 3)
    add_shared(pick, "--seed", usual="as configured")
    add_device(pick)
    detector = "The detector: truth, none, or a folder that graycast detector train wrote."
    add_option(pick, "--detector", str, detector, usual="as configured", metavar="DETECTOR")
    pose = "The source of the pose of a part."
    add_option(pick, "--pose", ("found", "truth"), pose, usual="as configured")
    add_option(
        pick,
        "--depth",
        str,
        "The depth that the robot uses: scanner, perfect, or a number such as 0.0002, which is the "
        "standard deviation in metres of Gaussian noise on perfect depth.",
        usual="as configured",
        metavar="KIND",
    )
    add_workers(pick)


def _need_robot() -> None:
    """Raise GraycastError if the robot's libraries are not installed."""
    try:
        import pinocchio  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "the robot needs libraries that are not installed: run pip install 'graycast[pick]'"
        ) from error


def _pick(options: argparse.Namespace) -> int:
    _need_robot()
    from ..robot.pick import load_pick_config, pick, read_episodes, resolve_pick_cell, summarize

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
            bars.line(failed_line(f"bin {outcome.scene_id:06d}", outcome))

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
    print_missing(f"bin {bin_id:06d}" for bin_id in lost)
    return 1 if lost else 0


def _with_options(config, options: argparse.Namespace):
    """Return the configuration, changed by the options of the command line and checked again."""
    from ..base.settings import check_settings
    from ..robot.pick.bin.pick_sections import PickConfig

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
    picking = settings["picking"] | changed
    return check_settings(settings | {"picking": picking}, PickConfig, options.config)


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


def _summary(options: argparse.Namespace) -> None:
    from ..robot.pick import compared, plot_runs, read_episodes, summarize

    runs = {str(folder): read_episodes(folder) for folder in options.picks}
    _tell(summarize(next(iter(runs.values()))))
    if len(runs) > 1:
        print(f"\n{compared(runs)}")
    if options.out is not None:
        summaries = {name: summarize(episodes) for name, episodes in runs.items()}
        plot_runs(summaries, options.out)
        print(f"{options.out}: a row for each of {len(summaries)} folders")


def _report(options: argparse.Namespace) -> None:
    from ..show.report.picks import write_pick_report

    _need_robot()
    with open_bars() as bars:
        summary = write_pick_report(
            options.picks,
            options.out,
            cell_folder=options.files,
            workers=options.workers,
            width_px=options.width,
            progress=bars,
        )
    print(f"{summary.built} bins made, {summary.current} were there; open {summary.page.resolve()}")


def _score_poses(options: argparse.Namespace) -> None:
    from ..base.folder import refuse_foreign, whole_folder
    from ..score.evaluate import POSES, Protocol, evaluate_poses, poses_markdown, write_poses

    if options.results.suffix != ".csv":
        raise GraycastError(
            f"{options.results} is no CSV file of poses: score detections with graycast detector "
            "score"
        )
    refuse_foreign(options.out, POSES)
    protocol = Protocol(
        min_visibility=options.min_visibility, draws=options.resamples, seed=options.seed
    )
    with whole_folder(options.out) as folder, open_bars() as bars:
        evaluation = evaluate_poses(
            options.results,
            options.on,
            split=options.split or "train",
            division=division_of(options),
            protocol=protocol,
            progress=bars,
        )
        write_poses(evaluation, folder)
    print(poses_markdown(evaluation), end="")
    print(options.out)


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
        f"an attempt takes {summary.seconds['scan'] / attempts:.2f} s to scan and "
        f"{summary.seconds['motion'] / attempts:.2f} s to move: {summary.picks_per_hour:.0f} picks "
        f"an hour; with the {summary.thinking_s:.2f} s (median) that this machine computes, "
        f"{summary.picks_per_hour_here:.0f}"
    )
