"""Commands that look at what was made: stats and report."""

import argparse
from pathlib import Path

from .arguments import add_command, positive, progress_bar
from .picking import add_cell, cell_folder, need_robot

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    stats = add_command(commands, "stats", _stats, "Count what a dataset holds, from its files.")
    _add_dataset(stats, "The dataset's folder.")
    stats.add_argument(
        "--out", type=Path, help="Also write stats.json and stats.png into this folder."
    )
    stats.add_argument(
        "--card",
        action="store_true",
        help="Also write the dataset's card, README.md in its folder.",
    )
    stats.add_argument(
        "--licence", help="The licence that the card states: an SPDX identifier such as CC-BY-4.0."
    )

    report = add_command(
        commands,
        "report",
        _report,
        "Write a web page to look at a dataset or at picks; it opens from the disk.",
    )
    report.set_defaults(when_stopped="what is finished is kept; the same command goes on")
    _add_dataset(report, "The folder of a dataset, or of picks.")
    report.add_argument("--out", type=Path, required=True, help="The page's folder.")
    report.add_argument(
        "--detections",
        type=Path,
        metavar="RESULTS",
        help="Also show what a detector found: a folder that graycast detect wrote, or a file of "
        "COCO results.",
    )
    report.add_argument(
        "--width",
        type=positive,
        help="Thin out maps that are wider than this many pixels (default: 1300).",
    )
    add_cell(report)


def _add_dataset(parser: argparse.ArgumentParser, told: str) -> None:
    parser.add_argument("dataset", type=Path, help=told)
    parser.add_argument(
        "--workers",
        type=positive,
        default=1,
        help="How many processes read the scenes (default: 1).",
    )


def _stats(options: argparse.Namespace) -> int:
    from rich.console import Console

    from ..dataset.stored import open_dataset
    from ..errors import GraycastError
    from ..stats import dataset_statistics, statistics_table, write_statistics

    if options.licence is not None and not options.card:
        raise GraycastError("--licence is of the card: give --card too, or leave it out")
    if options.licence is not None:
        from ..card import spdx

        spdx(options.licence)  # before the dataset is read
    with progress_bar() as bar:
        task = bar.add_task("scenes", total=len(open_dataset(options.dataset).pictures))
        statistics = dataset_statistics(
            options.dataset,
            workers=options.workers,
            on_scene=lambda _: bar.update(task, advance=1),
        )
    Console(width=None).print(statistics_table(statistics))
    if options.out is not None:
        write_statistics(statistics, options.out)
        print(options.out)
    if options.card:
        from ..card import write_card

        print(write_card(options.dataset, statistics, licence=options.licence))
    return 0


def _report(options: argparse.Namespace) -> int:
    from ..errors import GraycastError
    from ..report.page import WIDTH_PX, write_report

    if (options.dataset / "picks.json").exists():
        return _report_picks(options)
    if options.cell is not None:
        raise GraycastError(f"--cell is of picks, and {options.dataset} holds none: leave it out")
    with progress_bar() as bar:
        task = bar.add_task("scenes", total=None)
        summary = write_report(
            options.dataset,
            options.out,
            workers=options.workers,
            width_px=options.width or WIDTH_PX,
            detections=options.detections,
            on_start=lambda total, found: bar.update(task, total=total, completed=found),
            on_scene=lambda _: bar.update(task, advance=1),
        )
    print(f"{summary.built} scenes made, {summary.kept} were there; open {summary.page.resolve()}")
    return 0


def _report_picks(options: argparse.Namespace) -> int:
    from ..errors import GraycastError
    from ..report.page import WIDTH_PX
    from ..report.picks import write_pick_report

    if options.detections is not None:
        raise GraycastError("--detections is of a dataset: leave it out for picks")
    need_robot()
    with progress_bar() as bar:
        task = bar.add_task("bins", total=None)
        summary = write_pick_report(
            options.dataset,
            options.out,
            cell_folder=cell_folder(options),
            workers=options.workers,
            width_px=options.width or WIDTH_PX,
            on_start=lambda total, found: bar.update(task, total=total, completed=found),
            on_bin=lambda _: bar.update(task, advance=1),
        )
    print(f"{summary.built} bins made, {summary.kept} were there; open {summary.page.resolve()}")
    return 0
