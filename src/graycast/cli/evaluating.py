"""The command evaluate."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import add_command, positive, seed, share
from .bars import open_bars

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    evaluate = add_command(
        commands,
        "evaluate",
        _evaluate,
        "Score detections or poses against the labels of a dataset, with confidence intervals.",
    )
    evaluate.add_argument(
        "results",
        type=Path,
        nargs="?",
        help="The results to score: a folder that graycast detect wrote, a file of COCO "
        "results with detections, or a CSV file of BOP results with poses.",
    )
    evaluate.add_argument(
        "--on",
        type=Path,
        required=True,
        metavar="DATASET",
        help="The dataset to which the pictures belong, or an export of it.",
    )
    evaluate.add_argument(
        "--split",
        choices=("train", "val", "test"),
        help="The set of scenes to score (default: the set that graycast detect used; "
        "otherwise train, which holds all scenes of a dataset that is not divided).",
    )
    evaluate.add_argument(
        "--shares",
        metavar="SHARES",
        help="The shares of scenes in the train, val and test sets, such as 0.8,0.1,0.1 "
        "(default: the division that graycast detect used; otherwise none).",
    )
    evaluate.add_argument(
        "--split-seed",
        type=seed,
        default=0,
        help="The seed of the division by --shares (default: 0).",
    )
    _add_scoring(evaluate)


def _add_scoring(evaluate: argparse.ArgumentParser) -> None:
    """What counts, and how sure a score is."""
    evaluate.add_argument(
        "--against",
        type=Path,
        metavar="RESULTS",
        help="A second set of detections in the same scenes. The difference between the "
        "scores is reported with its confidence interval.",
    )
    evaluate.add_argument(
        "--kind",
        choices=("box", "mask"),
        help="Score only boxes or only masks (default: boxes, and also masks if results and "
        "labels have them).",
    )
    evaluate.add_argument(
        "--one-class",
        action="store_true",
        help="Treat all parts as one class, so that the kind of part that a detection names "
        "is ignored.",
    )
    evaluate.add_argument(
        "--min-visibility",
        type=share,
        default=0.1,
        metavar="SHARE",
        help="The smallest visible share of an instance, from 0 to 1; instances below it are "
        "ignored (default: 0.1).",
    )
    evaluate.add_argument(
        "--most",
        type=positive,
        default=300,
        metavar="N",
        help="The number of detections of each kind of part in a picture that are scored, "
        "best first (default: 300).",
    )
    evaluate.add_argument(
        "--draws",
        type=positive,
        default=1000,
        metavar="N",
        help="The number of bootstrap resamples of the scenes for the confidence intervals "
        "(default: 1000).",
    )
    evaluate.add_argument(
        "--seed",
        type=seed,
        default=0,
        help="The seed of the bootstrap resamples (default: 0).",
    )
    evaluate.add_argument(
        "--depth",
        action="store_true",
        help="Compare the scanner's depth of all scenes with perfect depth, instead of "
        "scoring detections. The result is bias, noise, spikes and holes by angle of "
        "incidence.",
    )
    evaluate.add_argument("--out", type=Path, required=True, help="The folder to write.")


def _evaluate(options: argparse.Namespace) -> int:
    if options.depth:
        return _depth(options)
    if options.results is None:
        raise GraycastError(
            "no results are given: give detections or poses to score, or --depth to score the "
            "scanner's depth"
        )
    if options.results.suffix == ".csv":
        return _poses(options)
    from ..base.folder import refuse_foreign, whole_folder
    from ..score.evaluate import EVALUATION, Protocol, Task, evaluate, summary, write_evaluation

    refuse_foreign(options.out, EVALUATION)
    division = _division(options)
    task = Task(
        results=options.results,
        dataset=options.on,
        split=options.split,
        division=division,
        against=options.against,
        kind=options.kind,
        one_class=options.one_class,
        protocol=Protocol(
            min_visibility=options.min_visibility,
            most=options.most,
            draws=options.draws,
            seed=options.seed,
        ),
    )
    with whole_folder(options.out) as folder, open_bars() as bars:
        evaluation, picture = evaluate(task, progress=bars)
        write_evaluation(evaluation, picture, folder)
    print(summary(evaluation))
    print(options.out)
    return 0


def _division(options: argparse.Namespace):
    """The division of the dataset by `--shares`; None without that option."""
    from ..dataset.export import Split, parse_shares

    if options.shares is None and options.split_seed:
        raise GraycastError(
            "--split-seed applies only with --shares: add --shares, or remove --split-seed"
        )
    if options.shares is None:
        return None
    return Split(shares=parse_shares(options.shares), seed=options.split_seed)


def _poses(options: argparse.Namespace) -> int:
    from ..base.folder import refuse_foreign, whole_folder
    from ..score.evaluate import POSES, Protocol, evaluate_poses, poses_markdown, write_poses

    for name in ("against", "kind", "one_class"):
        if getattr(options, name):
            raise GraycastError(
                f"--{name.replace('_', '-')} applies only to detections, and {options.results} "
                "holds poses: remove the option"
            )
    refuse_foreign(options.out, POSES)
    division = _division(options)
    protocol = Protocol(
        min_visibility=options.min_visibility, draws=options.draws, seed=options.seed
    )
    with whole_folder(options.out) as folder, open_bars() as bars:
        evaluation = evaluate_poses(
            options.results,
            options.on,
            split=options.split or "train",
            division=division,
            protocol=protocol,
            progress=bars,
        )
        write_poses(evaluation, folder)
    print(poses_markdown(evaluation), end="")
    print(options.out)
    return 0


def _depth(options: argparse.Namespace) -> int:
    from ..base.folder import refuse_foreign, whole_folder
    from ..camera.decode import REASON_COLOR
    from ..score.evaluate import DEPTH, evaluate_depth, write_depth

    for name in ("results", "against", "split", "shares", "kind"):
        if getattr(options, name) is not None:
            option = name if name == "results" else f"--{name}"
            raise GraycastError(
                f"{option} applies only to detections, and --depth only to the scanner's depth: "
                "give one of the two"
            )
    refuse_foreign(options.out, DEPTH)
    with whole_folder(options.out) as folder, open_bars() as bars:
        tables = evaluate_depth(
            options.on,
            progress=bars,
        )
        write_depth(tables, folder, colors=REASON_COLOR)
    print((options.out / "depth.md").read_text(encoding="utf-8"), end="")
    print(options.out)
    return 0
