"""Commands that judge: evaluate."""

import argparse
from pathlib import Path

from ..errors import GraycastError
from .arguments import add_command, positive, progress_bar, seed, share

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    evaluate = add_command(
        commands,
        "evaluate",
        _evaluate,
        "Score detections or poses by a dataset's labels, with intervals.",
    )
    evaluate.add_argument(
        "results",
        type=Path,
        nargs="?",
        help="The detections: a folder that graycast detect wrote, or a file of COCO results; or "
        "poses: a CSV file of BOP results.",
    )
    evaluate.add_argument(
        "--on",
        type=Path,
        required=True,
        metavar="DATASET",
        help="The dataset that the pictures are of, or an export of it.",
    )
    evaluate.add_argument(
        "--split",
        choices=("train", "val", "test"),
        help="The set that is judged (default: the one that graycast detect looked at; else "
        "train, which is the whole of a dataset that is not divided).",
    )
    evaluate.add_argument(
        "--shares",
        metavar="SHARES",
        help="How the dataset is divided by scene into train, val and test, such as 0.8,0.1,0.1 "
        "(default: as graycast detect did; else not at all).",
    )
    evaluate.add_argument(
        "--split-seed",
        type=seed,
        default=0,
        help="The seed of the division that --shares makes (default: 0).",
    )
    evaluate.add_argument(
        "--against",
        type=Path,
        metavar="RESULTS",
        help="Other detections in the same scenes; the difference is given with its interval.",
    )
    evaluate.add_argument(
        "--kind",
        choices=("box", "mask"),
        help="Compare only boxes, or only masks (default: boxes, and masks where both "
        "sides have them).",
    )
    evaluate.add_argument(
        "--one-class",
        action="store_true",
        help="Treat all parts as one class: it does not matter which part a detection names.",
    )
    evaluate.add_argument(
        "--min-visibility",
        type=share,
        default=0.1,
        metavar="SHARE",
        help="Ignore instances of which a smaller share is visible (default: 0.1).",
    )
    evaluate.add_argument(
        "--most",
        type=positive,
        default=300,
        metavar="N",
        help="How many detections of a part count in a picture, best first (default: 300).",
    )
    evaluate.add_argument(
        "--draws",
        type=positive,
        default=1000,
        metavar="N",
        help="How many times the scenes are drawn anew for the intervals (default: 1000).",
    )
    evaluate.add_argument(
        "--seed",
        type=seed,
        default=0,
        help="The seed of the draws that --draws counts (default: 0).",
    )
    evaluate.add_argument(
        "--depth",
        action="store_true",
        help="Judge the scanner's depth in all scenes by perfect depth instead of detections: "
        "bias, noise, spikes and holes by angle of incidence.",
    )
    evaluate.add_argument("--out", type=Path, required=True, help="The folder to write.")


def _evaluate(options: argparse.Namespace) -> int:
    if options.depth:
        return _depth(options)
    if options.results is None:
        raise GraycastError("give the results to judge, or --depth to judge the scanner's depth")
    if options.results.suffix == ".csv":
        return _poses(options)
    from ..evaluate import EVALUATION, Protocol, Task, evaluate, summary, write_evaluation
    from ..folder import refuse_foreign, whole_folder

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
    with whole_folder(options.out) as folder, progress_bar() as bar:
        going = bar.add_task("scenes", total=None)
        evaluation, picture = evaluate(
            task, on_scene=lambda done, total: bar.update(going, completed=done, total=total)
        )
        write_evaluation(evaluation, picture, folder)
    print(summary(evaluation))
    print(options.out)
    return 0


def _division(options: argparse.Namespace):
    """How the dataset is divided, where that was said."""
    from ..export import Split, parse_shares

    if options.shares is None and options.split_seed:
        raise GraycastError("--split-seed is of a division: give --shares too, or leave it out")
    if options.shares is None:
        return None
    return Split(shares=parse_shares(options.shares), seed=options.split_seed)


def _poses(options: argparse.Namespace) -> int:
    from ..evaluate import POSES, Protocol, evaluate_poses, poses_markdown, write_poses
    from ..folder import refuse_foreign, whole_folder

    for name in ("against", "kind", "one_class"):
        if getattr(options, name):
            raise GraycastError(
                f"--{name.replace('_', '-')} is of detections, {options.results} holds poses: "
                "leave it out"
            )
    refuse_foreign(options.out, POSES)
    division = _division(options)
    protocol = Protocol(
        min_visibility=options.min_visibility, draws=options.draws, seed=options.seed
    )
    with whole_folder(options.out) as folder, progress_bar() as bar:
        going = bar.add_task("scenes", total=None)
        evaluation = evaluate_poses(
            options.results,
            options.on,
            split=options.split or "train",
            division=division,
            protocol=protocol,
            on_scene=lambda done, total: bar.update(going, completed=done, total=total),
        )
        write_poses(evaluation, folder)
    print(poses_markdown(evaluation), end="")
    print(options.out)
    return 0


def _depth(options: argparse.Namespace) -> int:
    from ..decode import REASON_COLOR
    from ..evaluate import DEPTH, evaluate_depth, write_depth
    from ..folder import refuse_foreign, whole_folder

    for name in ("results", "against", "split", "shares", "kind"):
        if getattr(options, name) is not None:
            told = name if name == "results" else f"--{name}"
            raise GraycastError(
                f"{told} is of detections, --depth of the scanner: give one of both"
            )
    refuse_foreign(options.out, DEPTH)
    with whole_folder(options.out) as folder, progress_bar() as bar:
        going = bar.add_task("scenes", total=None)
        tables = evaluate_depth(
            options.on,
            on_scene=lambda done, total: bar.update(going, completed=done, total=total),
        )
        write_depth(tables, folder, colors=REASON_COLOR)
    print((options.out / "depth.md").read_text(encoding="utf-8"), end="")
    print(options.out)
    return 0
