"""Commands that show the contents of datasets and picks: stats and report."""

import argparse
from pathlib import Path

from .arguments import add_command, positive
from .bars import open_bars
from .picking import add_cell, cell_folder, need_robot

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    stats = add_command(
        commands, "stats", _stats, "Compute statistics of a dataset from its files."
    )
    _add_dataset(stats, "The folder of the dataset.")
    stats.add_argument(
        "--out", type=Path, help="A folder to which stats.json and stats.png are written."
    )
    stats.add_argument(
        "--card",
        action="store_true",
        help="Write the dataset's card, which is the file README.md in the folder of the dataset.",
    )
    stats.add_argument(
        "--licence",
        help="The licence that the card states, as an SPDX identifier such as "
        "CC-BY-4.0. It needs --card.",
    )

    report = add_command(
        commands,
        "report",
        _report,
        "Write a web page of a dataset or of picks, which a browser opens from the disk.",
    )
    report.set_defaults(
        when_stopped="the finished scenes are kept; run the same command again to continue"
    )
    _add_dataset(report, "The folder of a dataset, or a folder that graycast pick wrote.")
    report.add_argument(
        "--out", type=Path, required=True, help="The folder to which the page is written."
    )
    report.add_argument(
        "--detections",
        type=Path,
        metavar="RESULTS",
        help="Detections that the page also shows: a folder that graycast detect wrote, or a "
        "file of COCO results.",
    )
    report.add_argument(
        "--width",
        type=positive,
        help="The largest width of a picture on the page in pixels; wider pictures are "
        "subsampled (default: 1300).",
    )
    add_cell(report)


def _add_dataset(parser: argparse.ArgumentParser, purpose: str) -> None:
    parser.add_argument("dataset", type=Path, help=purpose)
    parser.add_argument(
        "--workers",
        type=positive,
        default=1,
        help="The number of processes that read the scenes (default: 1).",
    )


def _stats(options: argparse.Namespace) -> int:
    from rich.console import Console

    from ..base.errors import GraycastError
    from ..dataset.stats import dataset_statistics, statistics_table, write_statistics

    if options.licence is not None and not options.card:
        raise GraycastError("--licence applies only with --card: add --card, or remove --licence")
    if options.licence is not None:
        from ..dataset.card import spdx

        spdx(options.licence)  # before the dataset is read
    with open_bars() as bars:
        statistics = dataset_statistics(options.dataset, workers=options.workers, progress=bars)
    Console(width=None).print(statistics_table(statistics))
    if options.out is not None:
        write_statistics(statistics, options.out)
        print(options.out)
    if options.card:
        from ..dataset.card import write_card

        print(write_card(options.dataset, statistics, licence=options.licence))
    return 0


def _report(options: argparse.Namespace) -> int:
    from ..base.errors import GraycastError
    from ..show.report.page import WIDTH_PX, write_report

    if (options.dataset / "picks.json").exists():
        return _report_picks(options)
    if options.cell is not None:
        raise GraycastError(
            f"--cell applies only to picks, and {options.dataset} holds no picks: remove --cell"
        )
    with open_bars() as bars:
        summary = write_report(
            options.dataset,
            options.out,
            workers=options.workers,
            width_px=options.width or WIDTH_PX,
            detections=options.detections,
            progress=bars,
        )
    print(f"{summary.built} scenes made, {summary.kept} were there; open {summary.page.resolve()}")
    return 0


def _report_picks(options: argparse.Namespace) -> int:
    from ..base.errors import GraycastError
    from ..show.report.page import WIDTH_PX
    from ..show.report.picks import write_pick_report

    if options.detections is not None:
        raise GraycastError(
            "--detections applies only to a dataset, and this folder holds picks: remove "
            "--detections"
        )
    need_robot()
    with open_bars() as bars:
        summary = write_pick_report(
            options.dataset,
            options.out,
            cell_folder=cell_folder(options),
            workers=options.workers,
            width_px=options.width or WIDTH_PX,
            progress=bars,
        )
    print(f"{summary.built} bins made, {summary.kept} were there; open {summary.page.resolve()}")
    return 0
