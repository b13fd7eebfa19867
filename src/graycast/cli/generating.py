"""Commands that make scenes for a dataset: generate, rerender."""

import argparse
from pathlib import Path

from ..base.errors import DatasetError, one_line
from .arguments import (
    add_backend,
    add_command,
    add_config,
    add_device,
    add_seed,
    add_workers,
    load_cell,
    positive,
    print_shares,
    resolve_cell_option,
    seed,
    workers_of,
)
from .bars import open_bars

# Heavy modules are imported by the command that needs them, so that --help answers at once.

GENERATE = """\
Make a dataset, or continue one. If the command is stopped or killed, the same command continues
the dataset, because a scene depends only on the configuration, the seed and the number of the
scene. If a worker dies, it is replaced and its scene is made again. If a scene fails three
times, it is set aside, set_aside.json states the reason, the other scenes are made, and the
exit code is 1. The file README.md in the folder describes the dataset."""


def add_commands(commands) -> None:
    generate = add_command(commands, "generate", _generate, "Make a dataset, or continue one.")
    generate.description = GENERATE
    generate.set_defaults(
        when_stopped="the finished scenes are kept; run the same command again to continue"
    )
    add_config(generate)
    generate.add_argument("--out", type=Path, required=True, help="The folder of the dataset.")
    generate.add_argument(
        "--scenes",
        type=positive,
        help="The number of scenes in the complete dataset (default: as configured).",
    )
    add_seed(generate)
    add_backend(generate)
    add_device(generate)
    add_workers(generate, "scenes are made")

    rerender = add_command(
        commands,
        "rerender",
        _rerender,
        "Make a scene of a dataset again, and list the files that differ from the stored ones.",
    )
    rerender.add_argument("dataset", type=Path, help="The folder of the dataset.")
    rerender.add_argument("scene_id", type=seed, help="The number of the scene, counted from 0.")
    rerender.add_argument(
        "--config",
        type=Path,
        help="The configuration that made the dataset. It is needed only if the "
        "configuration names files, such as meshes.",
    )
    add_device(rerender)


def _generate(options: argparse.Namespace) -> int:
    from ..base.usage import GpuWatch
    from ..cell.generate import generate
    from ..dataset.card import CARD, write_card

    workers = workers_of(options)
    cell = load_cell(options)
    config = cell.config
    scenes = options.scenes or config.scenes
    chosen_seed = config.seed if options.seed is None else options.seed
    backend = config.render.backend
    print(
        f"{scenes} scenes of {', '.join(part.name for part in cell.scene.parts)} by "
        f"{backend}{_where(backend, options)}, {_rigs(cell)}, seed {chosen_seed}, {_who(workers)}"
    )
    with open_bars() as bars, GpuWatch() as gpu:

        def report(scene) -> None:
            decoded = f"{scene.reasons['decoded']:.1%} of all pixels decoded"
            if scene.part_reasons:
                decoded = f"{scene.part_reasons['decoded']:.1%} of the parts' pixels, {decoded}"
            busy = "" if gpu.share is None else f", GPU busy {gpu.share:.0%} of the time"
            bars.line(f"scene {scene.scene_id:06d}  {scene.seconds:6.1f} s  {decoded}{busy}")

        def failed(scene) -> None:
            then = "set aside" if scene.final else "will be made again"
            bars.line(f"scene {scene.scene_id:06d}  {then}: {one_line(scene.error)}")

        summary = generate(
            cell,
            options.out,
            scenes=scenes,
            seed=chosen_seed,
            device=options.device,
            workers=workers,
            progress=bars,
            on_result=report,
            on_failed=failed,
        )
    if summary.written or not (options.out / CARD).exists():
        write_card(options.out)  # an existing card may have a licence or the figures of all scenes
    _tell(summary, options.out)
    if summary.written and gpu.share is not None:
        print(f"  the GPU was busy {gpu.share:.0%} of the time")
    return 1 if summary.set_aside else 0


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
    print(f"{out}: {summary.written} scenes made, {summary.found} were there", end="")
    print(f", {summary.seconds:.1f} s")
    print_shares(summary.part_reasons, summary.reasons)
    for scene in summary.set_aside:
        print(f"  scene {scene.scene_id:06d} is missing after {scene.tries} tries: {scene.reason}")
    if summary.set_aside:
        print(
            f"  run the same command again to retry the missing scenes; {out / 'set_aside.json'} "
            "lists them"
        )


def _rerender(options: argparse.Namespace) -> int:
    from ..cell.config import load_config
    from ..cell.generate import read_origin, rerender

    origin = read_origin(options.dataset)
    config = origin.config
    if options.config is not None:
        settings = load_config(options.config)
        backend = config.render.backend  # the dataset may have been made with --backend
        config = settings.model_copy(
            update={"render": settings.render.model_copy(update={"backend": backend})}
        )
    elif origin.files:
        raise DatasetError(
            f"{options.dataset} was made from files of its own ({', '.join(origin.files)}): add "
            "--config with the configuration file that names them"
        )
    else:
        options.config = options.dataset / "graycast.json"
    cell = resolve_cell_option(config, options)
    differing = rerender(
        cell, options.dataset, options.scene_id, seed=origin.seed, device=options.device
    )
    scene = options.dataset / "train" / f"{options.scene_id:06d}"
    for name, how in differing.items():
        print(f"{name} {how}")
    print(f"{scene}: {len(differing)} file(s) differ" if differing else f"{scene}: the same")
    return 1 if differing else 0
