"""The command that labels grasps: grasps."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError, one_line
from .arguments import add_command, add_seed, positive
from .arguments import seed as whole
from .bars import open_bars

# Heavy modules are imported by the command that needs them, so that --help answers at once.

GRASPS = """\
Label the grasps of the parts of a dataset for one tool. Each instance gets grasps with an
analytic score and with the result of the collision check against the bin and the other parts.
Some grasps of each scene are simulated with rigid-body physics, which tells whether the part is
lifted out of the heap. The labels are written to DATASET/grasps/NAME, and no other file of the
dataset changes. If the command is stopped, the same command continues it. At the end it reports
how well the score ranks the grasps that held in the simulation. It needs pip install
'graycast[pick]'."""


def add_commands(commands) -> None:
    grasps = add_command(
        commands, "grasps", _grasps, "Label where a gripper can hold the parts of a dataset."
    )
    grasps.description = GRASPS
    grasps.set_defaults(
        when_stopped="the labelled scenes are kept; run the same command again to continue"
    )
    grasps.add_argument("dataset", type=Path, help="The folder of the dataset.")
    grasps.add_argument(
        "--tool",
        type=Path,
        required=True,
        help="The configuration of a robot cell, such as configs/cells/ur5e_suction.yaml, or "
        "a file with only its section tool.",
    )
    grasps.add_argument(
        "--name",
        help="The name of this set of labels (default: the kind of the tool, suction or jaws).",
    )
    grasps.add_argument(
        "--per-instance",
        type=positive,
        default=20,
        help="The largest number of labels of an instance (default: 20).",
    )
    grasps.add_argument(
        "--simulate",
        type=whole,
        default=10,
        help="The number of labels of each scene that are simulated with physics (default: 10).",
    )
    grasps.add_argument(
        "--places",
        type=positive,
        default=400,
        help="The number of candidate grasps on each kind of part (default: 400).",
    )
    add_seed(grasps, 0)
    grasps.add_argument(
        "--files",
        type=Path,
        default=Path(),
        help="The folder of the configuration that made the dataset. It is needed only if "
        "the configuration names files by relative paths (default: the current folder).",
    )
    grasps.add_argument(
        "--workers",
        type=positive,
        default=1,
        help="The number of scenes that are labelled at the same time (default: 1).",
    )


def _grasps(options: argparse.Namespace) -> int:
    try:
        import coal  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "the collision check of the tool needs a library that is not installed: run pip "
            "install 'graycast[pick]'"
        ) from error
    from ..robot.grasp_labels import Labelling, label_dataset, rank, read_tool

    tool = read_tool(options.tool)
    labelling = Labelling(
        tool=tool,
        places=options.places,
        per_instance=options.per_instance,
        simulate=options.simulate,
    )
    name = options.name or tool.kind
    if Path(name).name != name or name.startswith("."):
        raise GraycastError(
            f"--name is {name!r}: it names a folder, so give a name without / that does not begin "
            "with a dot"
        )
    with open_bars() as bars:

        def report(key, outcome) -> None:
            number = {word: int(count) for word, count in outcome.reasons.items()}
            bars.line(
                f"{key}  {outcome.seconds:6.1f} s  {number['grasps']} labels, "
                f"{number['held']} of {number['simulated']} lifted"
            )

        def failed(key, outcome) -> None:
            bars.line(f"{key}  failed: {one_line(outcome.error)}")

        lost = label_dataset(
            options.dataset,
            labelling,
            name=name,
            seed=options.seed,
            files=options.files,
            workers=options.workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    _tell(rank(options.dataset, name))
    labels = options.dataset / "grasps" / name
    print(f"{labels}: the labels; docs/reference/formats.md describes them")
    return 1 if lost else 0


def _tell(ranking) -> None:
    reach = ", ".join(f"{count} {name}" for name, count in ranking.reach.items())
    print(f"{ranking.labels} labels in {ranking.scenes} scenes: {reach}")
    if not ranking.simulated:
        return
    ended = ", ".join(f"{count} {name}" for name, count in ranking.ended.items())
    rate, low, high = ranking.rate
    print(
        f"{ranking.simulated} carried out: {rate:.1%} held (95 % interval {low:.1%} to "
        f"{high:.1%}); {ended}"
    )
    for band in ranking.bands:
        if band.grips:
            span = "0" if band.high == 0 else f"above {band.low:g} to {band.high:g}"
            rate, low, high = band.rate
            print(
                f"  score {span:18} {band.held:4d} of {band.grips:4d} held, {rate:6.1%} "
                f"({low:.1%} to {high:.1%})"
            )
    print(f"the score ranks success with ROC AUC {_interval(ranking.auc)}")
    print(f"  among scores above 0               {_interval(ranking.auc_above_0)}")


def _interval(figure) -> str:
    if figure.value != figure.value:
        return "unknown: all were held, or none"
    return f"{figure.value:.3f} (95 % interval {figure.low:.3f} to {figure.high:.3f})"
