"""Commands that carry datasets elsewhere and bring real pictures in: export, import-real."""

import argparse
from pathlib import Path

from .arguments import (
    add_command,
    add_scanner_files,
    distortion_of,
    intrinsics_of,
    positive,
    progress_bar,
    seed,
    share,
)

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
    export = add_command(commands, "export", _export, "Write a dataset in another format.")
    export.add_argument("dataset", type=Path, help="The dataset's folder.")
    export.add_argument(
        "--format",
        choices=_FORMATS,
        required=True,
        help="The format; docs/exports.md describes each.",
    )
    export.add_argument(
        "--out", type=Path, required=True, help="The folder to write; it is new or empty."
    )
    export.add_argument(
        "--scenes",
        type=Path,
        metavar="FILE",
        help="Export only the scenes of this file, which the page of graycast report saves.",
    )
    export.add_argument(
        "--split",
        default="1",
        metavar="SHARES",
        help="The shares of scenes that go to train, val and test, such as 0.8,0.1,0.1 "
        "(default: all are train).",
    )
    export.add_argument(
        "--split-seed",
        type=seed,
        default=0,
        help="Another seed puts other scenes into each set (default: 0).",
    )
    export.add_argument(
        "--image",
        choices=("rgb", "gray"),
        help="Which picture is exported: the colour picture, or the scanner's white frame "
        "(default: rgb).",
    )
    export.add_argument(
        "--depth",
        choices=("perfect", "scanner", "both", "none"),
        help="Which depth is exported (default: what suits the format).",
    )
    export.add_argument(
        "--polygons",
        action="store_true",
        default=None,
        help="Write masks as polygons instead of run lengths; for coco only.",
    )
    export.add_argument(
        "--labels",
        choices=("segments", "boxes"),
        help="Write each part as its outline or as its box; for yolo only (default: segments).",
    )
    export.add_argument(
        "--cloud",
        choices=("ply", "pcd"),
        help="The kind of file that holds a point cloud; for clouds only (default: ply).",
    )
    export.add_argument(
        "--organised",
        action="store_true",
        default=None,
        help="Clouds only: write a point for every pixel, NaN where there is none.",
    )
    export.add_argument(
        "--pixel-origin",
        choices=("centre", "corner"),
        help="BOP only: what of the top-left pixel is (0, 0). The renderers of bop_toolkit want "
        "its corner (default: centre).",
    )
    export.add_argument(
        "--shard-scenes", type=positive, metavar="N", help="How many scenes one file holds at most."
    )
    export.add_argument(
        "--link",
        action="store_true",
        default=None,
        help="Link to the dataset's pictures (hard links) instead of copying them.",
    )
    export.add_argument(
        "--min-visibility",
        type=share,
        metavar="SHARE",
        help="Leave out parts of which a smaller share is visible, such as 0.1 (default: 0).",
    )

    real = add_command(
        commands, "import-real", _import_real, "Make a dataset of real pictures and their labels."
    )
    real.add_argument(
        "folder",
        type=Path,
        help="The folder of the pictures; it holds rgb, gray and depth, or some of them.",
    )
    real.add_argument(
        "--out", type=Path, required=True, help="The folder to write; it is new or empty."
    )
    add_scanner_files(real, distortion=" (default: none)")
    real.add_argument(
        "--annotations",
        type=Path,
        help="The labels: a COCO file, or a folder of LabelMe files (default: FOLDER/annotations).",
    )
    real.add_argument("--unlabelled", action="store_true", help="Take the pictures without labels.")
    real.add_argument(
        "--like",
        type=Path,
        metavar="DATASET",
        help="Give the objects the names and numbers that they have in this dataset.",
    )


def _export(options: argparse.Namespace) -> int:
    from ..export import Options, Split, export, parse_shares

    split = Split(shares=parse_shares(options.split), seed=options.split_seed)
    said = {name: getattr(options, name) for name in _OPTIONS}
    chosen = Options(format=options.format, split=split, **said)
    with progress_bar() as bar:
        task = bar.add_task("scenes", total=None)
        record = export(
            options.dataset,
            options.out,
            chosen,
            selection=options.scenes,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    counts = ", ".join(f"{name} {len(ids)}" for name, ids in record.splits.items())
    print(f"{options.out}: {record.format}, scenes: {counts}")
    return 0


def _import_real(options: argparse.Namespace) -> int:
    from ..dataset.real import absent
    from ..dataset.stored import open_dataset
    from ..real.import_real import import_real

    names = None
    if options.like is not None:
        names = list(open_dataset(options.like).categories.values())
    with progress_bar() as bar:
        task = bar.add_task("pictures", total=None)
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
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    objects = ", ".join(f"{i} {name}" for i, name in enumerate(done.categories, start=1))
    print(f"{options.out}: {len(done.stems)} pictures, {done.instances} instances of {objects}")
    print(f"  not known: {', '.join(absent(options.out))}")
    return 0
