"""Simulated stacks with true depth, on which decoders are compared.

docs/measurements/decoders.md describes the files. A change of `SCENES` or of the codes makes all
published figures incomparable.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from graycast.base.errors import GraycastError
from graycast.base.folder import new_folder
from graycast.camera.scanner import Scanner
from graycast.dataset.files.sample import Raw
from graycast.dataset.write.raw import raw_files
from graycast.rendering import Quality, Renderer, open_renderer
from graycast.rig.pattern import CODECS, CodeSpec
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material

from .decoders import bare, pictures_of, shared_patterns
from .materials import MATERIALS
from .stages import cell_of

SAMPLES = 64
TRUTH, ABOUT = "truth.npz", "scene.yaml"
RIGS = ("like-phoxi-m", "like-phoxi-s", "like-phoxi-l", "like-zivid-2-m70", "paper")


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkScene:
    """A heap of equal parts in front of a scanner."""

    rig: str
    material: str
    parts: int
    seed: int


# Every material occurs twice, each time with another rig.
SCENES = tuple(
    BenchmarkScene(
        rig=RIGS[number % len(RIGS)],
        material=list(MATERIALS)[number % len(MATERIALS)],
        parts=10 + 5 * (number % 4),
        seed=5200 + number,
    )
    for number in range(16)
)


def codes_of(own: Scanner) -> dict[str, Scanner]:
    """Return the scanner with each of the six codes on both axes, and without limits.

    The Gray code has inverse pictures, because OpenCV's decoder needs them.
    """
    free = bare(own)
    return {
        codec: replace(free, code=CodeSpec(codec=codec, inverses=True if codec == "gray" else None))
        for codec in CODECS
    }


def write_scenes(
    folder: Path,
    numbers: Iterable[int],
    *,
    samples: int = SAMPLES,
    on_scene: Callable[[int], None] = lambda number: None,
) -> Iterator[Path]:
    """Write the scenes that the folder lacks, and yield the folder of each scene.

    Args:
        on_scene: receives the number of each scene before it is rendered.

    Raises:
        GraycastError: a number is not that of a scene.
    """
    numbers = list(numbers)
    if unknown := [number for number in numbers if number not in range(len(SCENES))]:
        raise GraycastError(f"there is no scene {unknown[0]}: give numbers up to {len(SCENES) - 1}")
    folder.mkdir(parents=True, exist_ok=True)
    with open_renderer("mitsuba") as renderer:
        for number in numbers:
            final = folder / f"scene_{number:02d}"
            if not final.exists():
                on_scene(number)
                with new_folder(final) as work:
                    _fill(renderer, SCENES[number], work, samples)
            yield final


def _fill(renderer: Renderer, scene: BenchmarkScene, folder: Path, samples: int) -> None:
    cell = cell_of({"count": scene.parts, "rig": scene.rig, "resolution": "small"})
    material = Material(**MATERIALS[scene.material])
    world = replace(cell.scene, parts=(replace(cell.scene.parts[0], material=material),))
    layout = drop(world, (scene.parts,), seed=scene.seed, limits=DropLimits())
    scanners = codes_of(cell.scanner)
    keys, patterns = shared_patterns([*scanners.values()])
    quality = Quality(samples=samples)
    rendering = renderer.render(world, layout, patterns, quality=quality, seed=scene.seed)
    for name, scanner in scanners.items():
        capture, _ = pictures_of(scanner, rendering.radiance, keys, seed=scene.seed)
        (folder / name).mkdir(parents=True)
        for file, content in raw_files(Raw(scanner=scanner, capture=capture)):
            (folder / name / Path(file).name).write_bytes(content)
    truth = rendering.truth
    np.savez_compressed(folder / TRUTH, depth_m=truth.depth_m, parts=truth.instance >= 0)
    about = asdict(scene) | {"samples": samples}
    (folder / ABOUT).write_text(yaml.safe_dump(about, sort_keys=False), encoding="utf-8")
