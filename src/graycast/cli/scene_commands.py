"""Commands for scenes and datasets: preview, generate, live, validate, report."""

import argparse
import shutil
from datetime import timedelta
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import (
    CONTINUE,
    NOTHING,
    add_command,
    add_config,
    add_device,
    add_option,
    add_out,
    add_png,
    add_shared,
    add_workers,
    cell_of,
    failed_line,
    print_shares,
    workers_of,
)
from .bars import open_bars
from .parts_command import add_parts
from .readers import positive, whole
from .rescan_command import add_rescan

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PORT = 8337
WIDTH_PX = 1300  # default of --width; equal to WIDTH_PX of show/report/page
GENERATE = """\
If the command is stopped or killed, the same command continues the dataset, because a scene depends
only on the configuration, the seed and the number of the scene. If a worker dies, it is replaced
and its scene is made again. If a scene fails three times, it is set aside, set_aside.json states
the reason, the other scenes are made, and the exit code is 1. The file README.md in the folder
describes the dataset."""
LIVE = """\
A change of exposure, noise, thresholds or filters takes effect at once, because the rendered light
is kept. A change of the light or the rig renders the scene again, first with few samples. A change
of the parts also simulates their fall again. The button Save writes a YAML file from which graycast
preview makes the same picture. The page can be opened only on this machine. Ctrl-C ends the
command."""


def add_commands(commands) -> None:
    preview = add_command(
        commands, "preview", _preview, "Make one scene, and draw its pictures and its depth.",
        example="configs/demo.yaml --out preview.png",
    )  # fmt: skip
    add_config(preview)
    add_png(preview, required=True)
    add_shared(preview, "--scene", default=0)
    add_option(
        preview,
        "--image",
        whole,
        "Which of the scene's images to make, of a cell that takes several: all images of its "
        "first scanner, then those of the next.",
        0,
    )
    add_shared(preview, "--seed", "--backend", usual="as configured")
    add_device(preview)

    generate = add_command(
        commands, "generate", _generate, "Make a dataset, or continue one.",
        example="configs/demo.yaml --out out/demo", more=GENERATE,
        when_stopped=f"the finished scenes are kept; {CONTINUE}",
    )  # fmt: skip
    add_config(generate)
    add_out(generate, "The folder of the dataset.")
    scenes = "The number of scenes in the complete dataset."
    add_option(generate, "--scenes", positive, scenes, usual="as configured")
    add_shared(generate, "--seed", "--backend", usual="as configured")
    add_device(generate)
    add_workers(generate)
    add_rescan(commands)

    live = add_command(
        commands, "live", _live, "Show a cell in the browser, and change its settings there.",
        example="configs/demo.yaml --open", more=LIVE,
        when_stopped="the files that the page saved are kept",
    )  # fmt: skip
    add_config(live)
    add_option(live, "--port", positive, "The TCP port of the page on this machine.", PORT)
    add_shared(live, "--scene", default=0)
    add_option(live, "--open", None, "Open the page in a browser.")
    add_device(live)
    _add_reading(commands)


def _add_reading(commands) -> None:
    """Add the commands that read existing data."""
    validate = add_command(
        commands, "validate", _validate, "Check that the files of a dataset are sound.",
        example="out/demo", more="They are complete and consistent with each other.",
    )  # fmt: skip
    add_option(validate, "dataset", Path, "The folder of the dataset.")
    add_option(
        validate,
        "--fast",
        None,
        "Check only the SHA-256 digest of every file, not whether the contents of the files are "
        "consistent.",
    )
    add_shared(validate, "--workers", default=1)

    report = add_command(
        commands, "report", _report, "Write a web page of a dataset.",
        example="out/demo --out out/page", more="A browser opens the page from the disk.",
        when_stopped=f"the finished scenes are kept; {CONTINUE}",
    )  # fmt: skip
    add_option(report, "dataset", Path, "The folder of the dataset.")
    add_out(report, "The folder to write.")
    add_shared(report, "--workers", default=1)
    add_option(
        report,
        "--detections",
        Path,
        "Detections that the page also shows: a folder that graycast detector find wrote, or a "
        "file of COCO results.",
    )
    add_shared(report, "--files", default=Path(), usual="the current folder")
    add_shared(report, "--width", default=WIDTH_PX)

    add_parts(commands)


def _preview(options: argparse.Namespace) -> int:
    from ..cell.framing import framing_line
    from ..cell.remedies import depth_note
    from ..cell.resolve import open_cell_renderer
    from ..cell.simulate import make_images
    from ..show.report import draw_preview

    cell = cell_of(options)
    if options.image >= len(cell.images):
        raise GraycastError(
            f"--image is {options.image}: a scene of this cell has {len(cell.images)}, from 0 on"
        )
    seed = cell.config.seed if options.seed is None else options.seed
    with open_bars() as bars:
        with open_cell_renderer(cell, device=options.device, progress=bars) as renderer:
            which = _which(cell, options.image)
            bars.line(f"scene {options.scene}{which} by {renderer.name} on {renderer.device}")
            images = make_images(
                cell,
                options.scene,
                seed=seed,
                renderer=renderer,
                progress=bars,
                only=options.image,
            )
            shot = next(images)
    scanner = dict(cell.scanners)[cell.images[options.image][0]]
    print(framing_line(shot.sample.scene, shot.sample.layout))
    _tell_coarse(shot)
    print_shares(shot.sample.manifest["part_reasons"], shot.sample.manifest["reasons"])
    if note := depth_note(shot, scanner):
        print(f"note: {note}")
    draw_preview(shot, scanner.light_code(), options.out)  # Drawn last: Ctrl-C leaves no file.
    print(options.out)
    return 0


def _which(cell, number: int) -> str:
    """Return a text with the image's number and scanner, or "" if a scene has only one image."""
    if len(cell.images) == 1:
        return ""
    sensor, image = cell.images[number]
    scanner = f" of scanner {sensor}" if sensor else ""
    return f", image {image}{scanner} ({number + 1} of {len(cell.images)})"


def _tell_coarse(shot) -> None:
    """Print a note for each dropped part that has coarse collision hulls."""
    from ..world.drop import hull_notes, prepare

    sample = shot.sample
    parts = [sample.scene.parts[kind] for kind in sorted({*sample.layout.part_index})]
    for note in hull_notes(parts, prepare(parts)):
        print(f"note: {note}")


def _generate(options: argparse.Namespace) -> int:
    from ..base.usage import GpuWatch
    from ..cell.generate import generate
    from ..dataset.card import counts_all_scenes, write_card

    workers = workers_of(options)
    cell = cell_of(options)
    config = cell.config
    scenes = options.scenes or config.scenes
    seed = config.seed if options.seed is None else options.seed
    backend = config.render.backend
    print(
        f"{scenes} scenes of {', '.join(part.name for part in cell.scene.parts)} by "
        f"{backend}{_where(backend, options)}, {_rigs(cell)}, seed {seed}, {_who(workers)}"
    )
    reports = 0
    with open_bars() as bars, GpuWatch() as gpu:

        def report(scene) -> None:
            nonlocal reports
            reports += 1
            decoded = f"{scene.reasons['decoded']:.1%} of all pixels decoded"
            if scene.part_reasons:
                decoded = f"{scene.part_reasons['decoded']:.1%} of the parts' pixels, {decoded}"
            busy = "" if gpu.share is None else f", GPU busy {gpu.share:.0%} of the time"
            bars.line(f"scene {scene.scene_id:06d}  {scene.seconds:6.1f} s  {decoded}{busy}")
            # The first scene of each worker takes longer, because it compiles or loads kernels.
            if reports == 1 or (workers.count and reports == workers.count + 1):
                there = (options.out / "train" / f"{k:06d}" for k in range(scenes))
                if left := sum(not folder.exists() for folder in there):
                    timed = workers.count if reports > 1 else 0
                    bars.line(_ahead(scene, left, timed, options.out))

        def failed(scene) -> None:
            name = f"scene {scene.scene_id:06d}"
            bars.line(failed_line(name, scene, if_final="set aside"))

        summary = generate(
            cell,
            options.out,
            scenes=scenes,
            seed=seed,
            device=options.device,
            workers=workers,
            progress=bars,
            on_result=report,
            on_failed=failed,
        )
    # A card may already count all these scenes; after a stopped run, it counts fewer.
    if summary.written or not counts_all_scenes(options.out):
        write_card(options.out)
    _tell(summary, options.out)
    if summary.written and gpu.share is not None:
        print(f"  the GPU was busy {gpu.share:.0%} of the time")
    return 1 if summary.set_aside else 0


def _ahead(scene, left: int, workers: int, out: Path) -> str:
    """Return a text about the time and disk space for the other scenes, estimated from this one.

    The time is left out if the number of workers is 0.
    """
    size_gb = 1e-9 * left * sum(len(data) for _, data in scene.files)
    free_gb = 1e-9 * shutil.disk_usage(out).free
    time = ""
    if workers:
        seconds = round(left * scene.seconds / min(workers, left))
        time = f"about {timedelta(seconds=seconds)} and "
    text = f"the other {left} scenes take {time}{size_gb:.2g} GB; {free_gb:.3g} GB are free"
    return text if size_gb < free_gb else f"{text}: stop with Ctrl-C and choose a larger disk"


def _where(backend: str, options: argparse.Namespace) -> str:
    from ..rendering import choose_device

    if options.engine == "ray":
        return ""  # each machine of the cluster chooses its own device
    return f" on {choose_device(backend, options.device)}"


def _rigs(cell) -> str:
    if len(cell.images) == 1:
        return f"rig {cell.scene.rig.name}"
    rigs = ", ".join(" ".join(filter(None, (s.rig.name, name))) for name, s in cell.scanners)
    return f"{len(cell.images)} images a scene by rig {rigs}"


def _who(workers) -> str:
    count = f"{workers.count} worker(s)" if workers.count else "workers"
    return count if workers.engine == "local" else f"{count} on Ray"


def _tell(summary, out: Path) -> None:
    from ..camera.decode import little_depth_note

    print(f"{out}: {summary.written} scenes made, {summary.found} were there", end="")
    print(f", {summary.seconds:.1f} s")
    print_shares(summary.part_reasons, summary.reasons)
    if note := little_depth_note(summary.part_reasons):
        print(f"note: {note}; graycast preview tries what helps")
    for scene in summary.set_aside:
        print(f"  scene {scene.scene_id:06d} is missing after {scene.tries} tries: {scene.reason}")
    if summary.set_aside:
        print(
            f"  run the same command again to retry the missing scenes; {out / 'set_aside.json'} "
            "lists them"
        )


def _live(options: argparse.Namespace) -> int:
    import webbrowser

    from ..show.live import Server

    server = Server(
        options.config, port=options.port, scene_id=options.scene, device=options.device
    )
    print(f"{options.config} is shown at {server.url} (press Ctrl-C to end)", flush=True)
    if options.open:
        webbrowser.open(server.url)
    try:
        server.run()
    finally:
        server.release()
    return 0


def _validate(options: argparse.Namespace) -> int:
    from ..dataset.check.checking import each_problem
    from ..dataset.read.real import absent

    problems = 0
    for problem in each_problem(options.dataset, fast=options.fast, workers=options.workers):
        print(problem, flush=True)
        problems += 1
    sound = "every file has the digest with which it was written" if options.fast else "valid"
    print(f"{options.dataset}: {f'{problems} problem(s)' if problems else sound}")
    if not problems:
        for lacking in absent(options.dataset):
            print(f"  not known: {lacking}")
    return 1 if problems else 0


def _report(options: argparse.Namespace) -> int:
    from ..dataset.read.rescanned import is_rescanned
    from ..show.report.page import write_report
    from ..show.report.rescan_page import write_rescan_page

    if (options.dataset / "picks.json").exists():
        raise GraycastError(f"{options.dataset} holds picks: use graycast robot report")
    if is_rescanned(options.dataset):
        if options.detections is not None:
            raise GraycastError("--detections applies to a dataset of Graycast: remove it")
        options.when_stopped = NOTHING  # the page is not written in pieces
        with open_bars() as bars:
            result = write_rescan_page(
                options.dataset, options.out, width_px=options.width, progress=bars
            )
        print(f"{result.images} of {result.of} images are drawn; open {result.page.resolve()}")
        return 0
    with open_bars() as bars:
        summary = write_report(
            options.dataset,
            options.out,
            workers=options.workers,
            width_px=options.width,
            detections=options.detections,
            files=options.files,
            progress=bars,
        )
    print(
        f"{summary.built} scenes made, {summary.current} were there; open {summary.page.resolve()}"
    )
    return 0
