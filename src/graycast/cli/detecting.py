"""Commands about detectors: train, detect and study."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import above_zero, add_command, positive, seed, share
from .bars import open_bars

# Torch takes seconds to import and may be missing: a test compares these copies of its names.
MODELS = ("mask-rcnn", "yolov3", "solov2", "yolov7", "rf-detr")
INPUTS = ("rgb", "depth", "depth_sl", "depth_noisy", "rgbd")
HOLES = ("channel", "zero", "far")
_NOTES = 5  # At most this many notes are printed.

TRAIN = """\
Train a detector on datasets of Graycast, on their exports, or on datasets of real pictures. The
detector learns from the scenes of the train set, and the command keeps the weights that score
best on the val set. It writes detector.pt (the weights and the encoding of pictures),
history.csv and curves.png to the folder of the training. If a training is stopped or killed, the
same command continues it."""


def add_commands(commands) -> None:
    _add_train(commands)
    _add_detect(commands)
    _add_study(commands)


def _add_train(commands) -> None:
    train = add_command(commands, "train", _train, "Train a detector on datasets.")
    train.description = TRAIN
    train.set_defaults(when_stopped="run the same command again to continue from here")
    train.add_argument(
        "datasets",
        type=Path,
        nargs="+",
        help="Folders of Graycast datasets or of their exports. For a dataset from another "
        "source, give its file of COCO annotations or the folder of one of its BOP "
        "splits.",
    )
    train.add_argument(
        "--out", type=Path, required=True, help="The folder to which the training is written."
    )
    train.add_argument(
        "--model",
        choices=MODELS,
        default="mask-rcnn",
        help="The architecture of the network (default: mask-rcnn).",
    )
    train.add_argument(
        "--input",
        choices=INPUTS,
        default="depth_sl",
        help="The input of the network: rgb is the colour picture, depth is perfect depth, "
        "depth_sl is the scanner's depth, depth_noisy is perfect depth with Gaussian "
        "noise and random holes, and rgbd is colour with the scanner's depth (default: "
        "depth_sl).",
    )
    train.add_argument(
        "--one-class",
        action="store_true",
        help="Treat all parts as one class, so that the detector finds parts but does not "
        "tell which kind they are.",
    )
    train.add_argument(
        "--backbone",
        help="The backbone, which is the part of the network that computes features from "
        "pictures (default: the model's own).",
    )
    train.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help="A file of weights from another training or a publication, with which the "
        "training starts (default: random weights).",
    )
    train.add_argument(
        "--size",
        type=positive,
        default=384,
        metavar="PX",
        help="The longer side of the network's input picture in pixels (default: 384).",
    )
    _add_training(train)
    _add_device(train)
    train.add_argument(
        "--workers",
        type=seed,
        default=0,
        help="The number of additional processes that read pictures (default: 0).",
    )


def _add_training(train: argparse.ArgumentParser) -> None:
    """How the network learns, from which scenes, and how it sees them."""
    train.add_argument(
        "--epochs",
        type=positive,
        default=40,
        help="The number of epochs, which are passes over all pictures of the train set "
        "(default: 40).",
    )
    train.add_argument(
        "--patience",
        type=positive,
        default=10,
        help="The training ends after this number of consecutive validations without a "
        "better score (default: 10).",
    )
    train.add_argument(
        "--batch",
        type=positive,
        help="The number of pictures in one training step (default: the model's own).",
    )
    train.add_argument(
        "--learning-rate",
        type=above_zero,
        help="The highest learning rate of the schedule (default: the model's own).",
    )
    train.add_argument(
        "--split",
        default="0.8,0.1,0.1",
        metavar="SHARES",
        help="The shares of scenes in the train, val and test sets. They do not apply to an "
        "export, which is already divided (default: 0.8,0.1,0.1).",
    )
    train.add_argument(
        "--split-seed",
        type=seed,
        default=0,
        help="The seed that decides which scenes are in which set (default: 0).",
    )
    train.add_argument(
        "--min-visibility",
        type=share,
        default=0.1,
        metavar="SHARE",
        help="The smallest visible share of an instance, from 0 to 1. Instances below it are "
        "ignored: a detection of one counts neither as right nor as wrong (default: "
        "0.1).",
    )
    train.add_argument(
        "--holes",
        choices=HOLES,
        default="channel",
        help="How missing depth is encoded: as an additional channel, as zero, or as the far "
        "end of the range (default: channel).",
    )
    train.add_argument(
        "--no-relief",
        action="store_true",
        help="Omit the input channel that holds the height above the neighbourhood of each pixel.",
    )
    train.add_argument(
        "--range",
        type=_range,
        metavar="NEAR,FAR",
        help="The nearest and the farthest depth in metres, such as 0.6,1.2 (default: the "
        "range of the datasets).",
    )
    train.add_argument("--no-flips", action="store_true", help="Train without mirrored pictures.")
    train.add_argument(
        "--seed",
        type=seed,
        default=0,
        help="The seed of the weights, of the order of the pictures and of the augmentation "
        "(default: 0).",
    )


def _add_detect(commands) -> None:
    detect = add_command(
        commands,
        "detect",
        _detect,
        "Find parts in a dataset or in pictures with a trained detector.",
    )
    detect.add_argument(
        "detector", type=Path, help="The folder that graycast train wrote, or its file detector.pt."
    )
    detect.add_argument(
        "pictures",
        type=Path,
        nargs="?",
        help="A dataset, an export, or a folder with pictures in the subfolders rgb, gray "
        "and depth.",
    )
    detect.add_argument(
        "--out",
        type=Path,
        required=True,
        help="The folder to write, which may hold earlier detections. With --export, it is "
        "the file to write.",
    )
    detect.add_argument(
        "--export",
        choices=("onnx",),
        help="Write the detector as an ONNX file and check its output against that of torch, "
        "instead of finding parts in pictures.",
    )
    detect.add_argument(
        "--split",
        choices=("train", "val", "test", "all"),
        default="all",
        help="The set of scenes in which parts are found, such as test, which the training "
        "does not use (default: all).",
    )
    detect.add_argument(
        "--as-real",
        action="store_true",
        help="Treat the dataset as a real one. Its perfect depth is not used, and a detector "
        "that was trained on perfect depth gets the scanner's depth.",
    )
    detect.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="The length of one unit of depth in metres, such as 0.001 for millimetres, in "
        "files that belong to no dataset. Files of floating-point numbers are taken to "
        "be in metres without it.",
    )
    detect.add_argument(
        "--most",
        type=positive,
        default=300,
        help="The largest number of detections in a picture (default: 300).",
    )
    detect.add_argument(
        "--least-score",
        type=share,
        default=0.05,
        help="The lowest score of a detection that is kept, from 0 to 1 (default: 0.05).",
    )
    detect.add_argument(
        "--drawings",
        type=seed,
        default=12,
        help="The number of pictures in which the detections are drawn (default: 12).",
    )
    _add_device(detect)


def _add_study(commands) -> None:
    study = add_command(
        commands,
        "study",
        _study,
        "Train and score a detector for every combination of a study, and write one table.",
    )
    study.set_defaults(when_stopped="run the same command again to continue from here")
    study.add_argument(
        "study", type=Path, help="The YAML file of the study, such as configs/paper/study.yaml."
    )
    study.add_argument(
        "--out", type=Path, required=True, help="The folder to which the study is written."
    )
    study.add_argument(
        "--list", action="store_true", help="Only list the combinations, without training."
    )
    _add_device(study)


def _add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="The device on which the network runs; auto uses a GPU if there is one "
        "(default: auto).",
    )
    parser.add_argument(
        "--threads",
        type=positive,
        help="The number of processor threads of the network (default: the number that torch "
        "chooses).",
    )


def _range(text: str) -> tuple[float, float]:
    try:
        near_m, far_m = (float(word) for word in text.split(","))
    except ValueError:
        near_m, far_m = 0.0, 0.0
    if not 0 < near_m < far_m:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a range: give two distances in metres, such as 0.6,1.2"
        )
    return near_m, far_m


def need_torch() -> None:
    """Raise GraycastError if torch is not installed."""
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "detectors need PyTorch, which is not installed: run pip install 'graycast[detect]'"
        ) from error


def _torch(options: argparse.Namespace) -> None:
    """Check that torch is installed, and set its number of threads."""
    need_torch()
    import torch

    if options.threads is not None:
        torch.set_num_threads(options.threads)


def _train(options: argparse.Namespace) -> None:
    _torch(options)
    from ..dataset.export.split import Split, parse_shares
    from ..learn.detect import Augmentation, TrainSpec, train

    spec = TrainSpec(
        model=options.model,
        input=options.input,
        backbone=options.backbone,
        longest_px=options.size,
        holes=options.holes,
        relief=not options.no_relief,
        range_m=options.range,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        seed=options.seed,
        one_class=options.one_class,
        min_visibility=options.min_visibility,
        patience=options.patience,
        split=Split(shares=parse_shares(options.split), seed=options.split_seed),
        augmentation=Augmentation(flip=not options.no_flips),
        weights=options.weights,
        device=options.device,
        workers=options.workers,
    )
    with open_bars() as bars:
        train(
            options.datasets,
            options.out,
            spec,
            progress=bars,
            on_row=lambda row: bars.line(_line(row)),
        )
    print(
        f"{options.out}: the training is complete; detector.pt holds the weights of the best "
        "validation"
    )


def _line(row: dict[str, float]) -> str:
    text = f"epoch {row['epoch']:.0f}: loss {row['loss']:.3f}"
    for name in ("box_ap50", "mask_ap50", "box_ap", "mask_ap"):
        if name in row:
            text += f", {name.replace('_', ' ').replace('ap', 'AP')} {row[name]:.3f}"
    return text


def _detect(options: argparse.Namespace) -> None:
    _torch(options)
    from statistics import median

    from ..learn.detect import detect, load_detector, pictures_of

    detector = load_detector(options.detector, device=options.device)
    if options.export is not None:
        _export(detector, options)
        return
    if options.pictures is None:
        raise GraycastError("no pictures are given: give a dataset or a folder of pictures")
    pictures = pictures_of(
        options.pictures,
        detector.about,
        split=options.split,
        scale_m=options.scale,
        as_real=options.as_real,
    )
    with open_bars() as bars:
        detection = detect(
            detector,
            pictures,
            options.out,
            most=options.most,
            least_score=options.least_score,
            drawings=options.drawings,
            progress=bars,
        )
    count = sum(map(len, detection.found))
    print(
        f"{options.out}: {count} detections in {len(detection.found)} pictures, "
        f"{median(detection.ms_per_picture):.0f} ms a picture"
    )
    for note in detection.notes[:_NOTES]:
        print(f"note: {note}")
    if len(detection.notes) > _NOTES:
        print(f"note: there are {len(detection.notes) - _NOTES} more notes of this kind")


def _export(detector, options: argparse.Namespace) -> None:
    from ..learn.detect.onnx_file import write_onnx

    if options.pictures is not None:
        raise GraycastError(
            "--export writes the detector and needs no pictures: remove the argument pictures"
        )
    write_onnx(detector, options.out, most=options.most, least_score=options.least_score)
    print(f"{options.out}: written; onnxruntime finds in it what torch finds")


def _study(options: argparse.Namespace) -> None:
    _torch(options)
    from ..learn.study import read_study, run_study, runs_of, write_study

    spec = read_study(options.study)
    runs = list(runs_of(spec))
    if options.list:
        print("\n".join(run.name for run in runs))
        return
    with open_bars() as bars:

        def on_done(result) -> None:
            figures = [
                f"{kind} {world} {result.of(world, kind).value:.2f}"
                for world, kind in result.figures
            ]
            bars.line(f"{result.run.name}: AP50 {', '.join(figures)}")

        results = run_study(
            spec, options.out, device=options.device, progress=bars, on_done=on_done
        )
    write_study(spec, results, options.out)
    print((options.out / "table.md").read_text(encoding="utf-8"))
