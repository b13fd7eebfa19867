"""Commands that carry datasets elsewhere and bring real pictures in: export, import-real."""

import argparse
from pathlib import Path

from .arguments import (
    add_command,
    add_scanner_files,
    distortion_of,
    intrinsics_of,
    positive,
    seed,
    share,
)
from .bars import open_bars

_FORMATS = (
    "coco",
    "yolo",
    "bop-imagewise",
    "bop-webdataset",
    "webdataset",
    "parquet",
    "clouds",
)
_OPTIONS = (
    "image",
    "depth",
    "polygons",
    "labels",
    "cloud",
    "organised",
    "shard_scenes",
    "link",
    "pixel_origin",
    "min_visibility",
)


def add_commands(commands) -> None:
    _add_export(commands)
    _add_real(commands)


def _add_export(commands) -> None:
    export = add_command(commands, "export", _export, "Write a dataset in another format.")
    export.add_argument("dataset", type=Path, help="The folder of the dataset.")
    export.add_argument(
        "--format",
        choices=_FORMATS,
        required=True,
        help="The format to write. The page docs/how-to/exports.md describes each format.",
    )
    export.add_argument(
        "--out", type=Path, required=True, help="The folder to write, which must be new or empty."
    )
    export.add_argument(
        "--scenes",
        type=Path,
        metavar="FILE",
        help="A file that lists the scenes to export. The page of graycast report saves such "
        "files (default: all scenes).",
    )
    export.add_argument(
        "--split",
        default="1",
        metavar="SHARES",
        help="The shares of scenes in the train, val and test sets, such as 0.8,0.1,0.1 "
        "(default: all scenes are in train).",
    )
    export.add_argument(
        "--split-seed",
        type=seed,
        default=0,
        help="The seed that decides which scenes are in which set (default: 0).",
    )
    _add_contents(export)


def _add_contents(export: argparse.ArgumentParser) -> None:
    """What the files hold of each scene."""
    export.add_argument(
        "--image",
        choices=("rgb", "gray"),
        help="The picture to export: rgb is the colour picture, gray is the scanner's white "
        "frame (default: rgb).",
    )
    export.add_argument(
        "--depth",
        choices=("perfect", "scanner", "both", "none"),
        help="The depth to export (default: chosen by the format).",
    )
    export.add_argument(
        "--polygons",
        action="store_true",
        default=None,
        help="Write masks as polygons instead of run-length encoding. It applies only to the "
        "format coco.",
    )
    export.add_argument(
        "--labels",
        choices=("segments", "boxes"),
        help="Write each part as its outline (segments) or as its box. It applies only to "
        "the format yolo (default: segments).",
    )
    export.add_argument(
        "--cloud",
        choices=("ply", "pcd"),
        help="The file format of the point clouds. It applies only to the format clouds "
        "(default: ply).",
    )
    export.add_argument(
        "--organised",
        action="store_true",
        default=None,
        help="Write a point for every pixel, which is NaN where there is no depth. It "
        "applies only to the format clouds.",
    )
    export.add_argument(
        "--pixel-origin",
        choices=("centre", "corner"),
        help="The point of the top-left pixel that has the coordinates (0, 0). The renderers "
        "of bop_toolkit expect its corner. It applies only to the format bop (default: "
        "centre).",
    )
    export.add_argument(
        "--shard-scenes",
        type=positive,
        metavar="N",
        help="The largest number of scenes in one file.",
    )
    export.add_argument(
        "--link",
        action="store_true",
        default=None,
        help="Make hard links to the dataset's pictures instead of copies.",
    )
    export.add_argument(
        "--min-visibility",
        type=share,
        metavar="SHARE",
        help="The smallest visible share of an instance, such as 0.1; instances below it are "
        "not exported (default: 0).",
    )


def _add_real(commands) -> None:
    real = add_command(
        commands, "import-real", _import_real, "Make a dataset from real pictures and their labels."
    )
    real.add_argument(
        "folder",
        type=Path,
        help="The folder of the pictures, with one or more of the subfolders rgb, gray and depth.",
    )
    real.add_argument(
        "--out", type=Path, required=True, help="The folder to write, which must be new or empty."
    )
    add_scanner_files(real, distortion=" (default: none)")
    real.add_argument(
        "--annotations",
        type=Path,
        help="The labels: a COCO file, or a folder of LabelMe files (default: FOLDER/annotations).",
    )
    real.add_argument(
        "--unlabelled", action="store_true", help="Import the pictures without labels."
    )
    real.add_argument(
        "--like",
        type=Path,
        metavar="DATASET",
        help="A dataset whose names and numbers of objects are used. Depth far outside the range "
        "of its scanner is refused.",
    )


def _export(options: argparse.Namespace) -> int:
    from ..dataset.export import Options, Split, export, parse_shares

    split = Split(shares=parse_shares(options.split), seed=options.split_seed)
    settings = {name: getattr(options, name) for name in _OPTIONS}
    chosen = Options(format=options.format, split=split, **settings)
    with open_bars() as bars:
        record = export(
            options.dataset,
            options.out,
            chosen,
            selection=options.scenes,
            progress=bars,
        )
    counts = ", ".join(f"{name} {len(ids)}" for name, ids in record.splits.items())
    print(f"{options.out}: {record.format}, scenes: {counts}")
    return 0


def _import_real(options: argparse.Namespace) -> int:
    from ..dataset.real import absent
    from ..dataset.stored import open_dataset
    from ..real.import_real import import_real

    names = range_m = None
    if options.like is not None:
        like = open_dataset(options.like)
        names = list(like.categories.values())
        if rig := like.claim.get("rig"):  # a dataset of real pictures states none
            range_m = (float(rig["near_m"]), float(rig["far_m"]))
    with open_bars() as bars:
        done = import_real(
            options.folder,
            options.out,
            K=intrinsics_of(options),
            distortion=distortion_of(options) or (0.0, 0.0, 0.0, 0.0, 0.0),
            scale_m=options.scale,
            size_px=options.size,
            annotations=options.annotations,
            labelled=not options.unlabelled,
            names=names,
            range_m=range_m,
            progress=bars,
        )
    objects = ", ".join(f"{i} {name}" for i, name in enumerate(done.categories, start=1))
    print(f"{options.out}: {len(done.stems)} pictures, {done.instances} instances of {objects}")
    print(f"  not known: {', '.join(absent(options.out))}")
    for note in done.notes:
        print(f"  note: {note}")
    return 0
