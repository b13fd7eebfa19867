"""Commands that carry datasets elsewhere and bring real pictures in: export, import-real."""

import argparse
from pathlib import Path

from ..errors import GraycastError
from .arguments import above_zero, add_command, positive, progress_bar, seed, size

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
    export.add_argument("dataset", type=Path, help="the dataset's folder")
    export.add_argument("--format", choices=_FORMATS, required=True, help="see docs/exports.md")
    export.add_argument("--out", type=Path, required=True, help="a new folder")
    export.add_argument(
        "--split",
        default="1",
        metavar="SHARES",
        help="of train, val and test, by scene: 0.8,0.1,0.1 (default: all are train)",
    )
    export.add_argument("--split-seed", type=seed, default=0, help="another seed, another split")
    export.add_argument("--image", choices=("rgb", "gray"), help="colour or the white frame")
    export.add_argument(
        "--depth", choices=("perfect", "scanner", "both", "none"), help="which depth goes along"
    )
    export.add_argument(
        "--polygons", action="store_true", default=None, help="COCO: instead of run lengths"
    )
    export.add_argument("--labels", choices=("segments", "boxes"), help="YOLO: what a row is")
    export.add_argument("--cloud", choices=("ply", "pcd"), help="clouds: the kind of file")
    export.add_argument(
        "--organised", action="store_true", default=None, help="clouds: a point for every pixel"
    )
    export.add_argument(
        "--pixel-origin",
        choices=("centre", "corner"),
        help="BOP: what of the top-left pixel is (0, 0); bop_toolkit's renderers want its corner",
    )
    export.add_argument("--shard-scenes", type=positive, metavar="N", help="scenes per file")
    export.add_argument(
        "--link", action="store_true", default=None, help="hard links to the pictures, no copies"
    )
    export.add_argument(
        "--min-visibility", type=_share, metavar="SHARE", help="leave out what is hidden more"
    )

    real = add_command(
        commands, "import-real", _import_real, "Make a dataset of real pictures and their labels."
    )
    real.add_argument("folder", type=Path, help="has the folders rgb, gray, depth, or some of them")
    real.add_argument("--out", type=Path, required=True, help="a new folder")
    real.add_argument("--intrinsics", metavar="K", help="fx,fy,cx,cy or a file with K")
    real.add_argument("--distortion", metavar="D", help="k1,k2,p1,p2,k3 of OpenCV (default: none)")
    real.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="of one unit of depth: 0.001 for millimetres; integers need it, floats are metres",
    )
    real.add_argument("--size", type=size, metavar="WxH", help="of PLYs that do not say it")
    real.add_argument(
        "--annotations",
        type=Path,
        help="a COCO file, or a folder of LabelMe's (default: FOLDER/annotations)",
    )
    real.add_argument("--unlabelled", action="store_true", help="pictures without annotations")
    real.add_argument(
        "--like", type=Path, metavar="DATASET", help="the same objects under the same numbers"
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
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    counts = ", ".join(f"{name} {len(ids)}" for name, ids in record.splits.items())
    print(f"{options.out}: {record.format}, scenes: {counts}")
    return 0


def _import_real(options: argparse.Namespace) -> int:
    from ..dataset.real import absent
    from ..dataset.stored import open_dataset
    from ..import_real import import_real
    from ..realism import read_intrinsics

    names = None
    if options.like is not None:
        names = list(open_dataset(options.like).categories.values())
    with progress_bar() as bar:
        task = bar.add_task("pictures", total=None)
        done = import_real(
            options.folder,
            options.out,
            K=None if options.intrinsics is None else read_intrinsics(options.intrinsics),
            distortion=_distortion(options.distortion),
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


def _distortion(text: str | None) -> tuple[float, float, float, float, float]:
    if text is None:
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    try:
        k1, k2, p1, p2, k3 = (float(word) for word in text.split(","))
    except ValueError as error:
        raise GraycastError(f"distortion is {text!r}: give five numbers k1,k2,p1,p2,k3") from error
    return k1, k2, p1, p2, k3


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share from 0 to 1")
    return value
