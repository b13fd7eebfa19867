"""Commands about datasets: generate, preview, validate, parts."""

import argparse
from pathlib import Path

from ..errors import GraycastError
from .arguments import (
    add_backend,
    add_command,
    add_config,
    add_device,
    add_seed,
    positive,
    progress_bar,
    seed,
)

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    generate = add_command(commands, "generate", _generate, "Make a dataset, or go on with one.")
    generate.set_defaults(when_stopped="finished scenes are kept")
    add_config(generate)
    generate.add_argument("--out", type=Path, required=True, help="the dataset's folder")
    generate.add_argument("--scenes", type=positive, help="how many (default: as configured)")
    add_seed(generate)
    add_backend(generate)
    add_device(generate)
    generate.add_argument(
        "--workers", type=positive, default=1, help="processes that share the cores (default 1)"
    )

    preview = add_command(
        commands, "preview", _preview, "Make one scene and draw it as a contact sheet."
    )
    add_config(preview)
    preview.add_argument("--out", type=Path, required=True, help="the PNG to write")
    preview.add_argument("--scene", type=seed, default=0, help="which scene (default 0)")
    add_seed(preview)
    add_backend(preview)
    add_device(preview)

    validate = add_command(commands, "validate", _validate, "Check a dataset from its files alone.")
    validate.add_argument("dataset", type=Path, help="the dataset's folder")

    parts = add_command(
        commands, "parts", _parts, "List parts and picture them: built-in or a configuration's."
    )
    parts.add_argument("config", type=Path, nargs="?", help="show this configuration's parts")
    parts.add_argument("--out", type=Path, help="also draw them into this PNG")
    add_device(parts)


def _load_cell(options: argparse.Namespace):
    from ..cell import resolve_cell
    from ..config import load_config

    config = load_config(options.config)
    if getattr(options, "backend", None) is not None:
        render = config.render.model_copy(update={"backend": options.backend})
        config = config.model_copy(update={"render": render})
    try:
        cell = resolve_cell(config, options.config.parent)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(f"{options.config}: {error}") from error
    for note in cell.notes:
        print(f"note: {note}")
    return cell


def _generate(options: argparse.Namespace) -> int:
    from ..generate import Progress, generate
    from ..render import choose_device

    cell = _load_cell(options)
    config = cell.config
    scenes = options.scenes or config.scenes
    seed = config.seed if options.seed is None else options.seed
    backend = config.render.backend
    device = choose_device(backend, options.device)
    rig = cell.scene.rig
    print(
        f"{scenes} scenes of {', '.join(part.name for part in cell.scene.parts)} by {backend} on "
        f"{device}, rig {rig.name}, seed {seed}, {options.workers} worker(s)"
    )
    with progress_bar() as bar:
        task = bar.add_task("scenes", total=scenes)
        frames = bar.add_task("renders of a scene", total=None, visible=False)

        def on_progress(progress: Progress) -> None:
            decoded = progress.reasons["decoded"]
            bar.update(task, advance=1)
            bar.reset(frames, total=None, visible=False)
            bar.console.print(
                f"scene {progress.scene_id:06d}  {progress.seconds:6.1f} s  {decoded:.1%} decoded"
            )

        summary = generate(
            cell,
            options.out,
            scenes=scenes,
            seed=seed,
            device=options.device,
            workers=options.workers,
            on_start=lambda found: bar.update(task, completed=found),
            on_progress=on_progress,
            on_frame=lambda done, total: bar.update(
                frames, completed=done, total=total, visible=True
            ),
        )
    print(f"{options.out}: {summary.written} scenes made, {summary.found} were there", end="")
    print(f", {summary.seconds:.1f} s")
    for name, share in summary.reasons.items():
        print(f"  {name:18} {share:7.2%} of the pixels")
    return 0


def _preview(options: argparse.Namespace) -> int:
    from ..cell import open_cell_renderer
    from ..report import draw_preview
    from ..simulate import make_scene

    cell = _load_cell(options)
    seed = cell.config.seed if options.seed is None else options.seed
    with progress_bar() as bar:
        frames = bar.add_task("renders", total=None, visible=False)

        def on_frame(done: int, total: int) -> None:
            bar.update(frames, completed=done, total=total, visible=True)

        with open_cell_renderer(cell, device=options.device, on_frame=on_frame) as renderer:
            bar.console.print(f"scene {options.scene} by {renderer.name} on {renderer.device}")
            shot = make_scene(cell, options.scene, seed=seed, renderer=renderer)
    draw_preview(shot, cell.code, options.out)
    for name, share in shot.sample.manifest["reasons"].items():
        print(f"  {name:18} {share:7.2%} of the pixels")
    print(options.out)
    return 0


def _validate(options: argparse.Namespace) -> int:
    from ..dataset import validate
    from ..dataset.real import absent

    problems = validate(options.dataset)
    for problem in problems:
        print(problem)
    print(
        f"{options.dataset}: {len(problems)} problem(s)"
        if problems
        else f"{options.dataset}: valid"
    )
    if not problems:
        for lacking in absent(options.dataset):
            print(f"  not known: {lacking}")
    return 1 if problems else 0


def _parts(options: argparse.Namespace) -> int:
    from ..parts import BUILTIN, builtin_part
    from ..report import describe_parts, draw_parts

    if options.config is None:
        shown = tuple(builtin_part(name) for name in BUILTIN)
    else:
        shown = _load_cell(options).scene.parts
    print(describe_parts(shown))
    if options.out is not None:
        from ..render import open_renderer

        with open_renderer(device=options.device) as renderer:
            draw_parts(shown, options.out, renderer=renderer)
        print(options.out)
    return 0
