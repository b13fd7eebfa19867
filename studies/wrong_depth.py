"""The table from which the decoder takes the probability that a depth is wrong.

python -m studies.wrong_depth scenes out/wrong_depth
python -m studies.wrong_depth table out/wrong_depth
python -m studies.wrong_depth check

The first command simulates heaps of random parts and materials in random bins, scanned with several
rigs and with every code, and stores the cues of random pixels with the truth. A folder that exists
is continued. The second command fits the table, checks it on scenes that were left out, prints the
figures, and writes `wrong.npz` into the package. The third command uses the table for another part
in other heaps, with one other rig, and prints the tables of docs/measurements/wrong_depth.md.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32
from sklearn.ensemble import HistGradientBoostingClassifier

from benchmarks.decoders import (
    bare,
    calibration_error,
    pictures_of,
    reliability,
    shared_patterns,
    with_single_limits,
)
from benchmarks.materials import MATERIALS
from benchmarks.stages import cell_of
from benchmarks.zoo_parts import ZOO, zoo_part
from graycast.base.errors import DropError
from graycast.base.tables import markdown_table
from graycast.camera.decode import DepthMap, Reason, levels_of
from graycast.camera.decode.evidence import CUES, NAMES, TABLE, cues_of
from graycast.camera.scanner import Scanner, decode_capture, measure, take
from graycast.camera.sensor import Capture
from graycast.camera.sigma import bend_m, with_depth_term
from graycast.cell.resolve import patterns_of
from graycast.rendering import Quality, Radiance, Renderer, open_renderer
from graycast.rig.pattern import AXES, CODECS, CodeSpec
from graycast.rig.pattern.spec import Codec
from graycast.score.evaluate.shares import roc_auc
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material
from graycast.world.scene import Layout, Scene, bin_of

RIGS = (
    "like-phoxi-m", "like-phoxi-l", "like-phoxi-s", "like-zivid-2plus-m60", "like-phoxi-l",
    "paper", "like-phoxi-m", "like-mech-eye-pro-s", "like-phoxi-l", "lab-lightcrafter-4500",
)  # fmt: skip
SMALL, LOW = range(36), range(100, 104)  # numbers of the scenes, by resolution
CHECK_PART = "metal_workpiece_1"  # The third command uses it, so no scene of the table does.
PIXELS, PART_PIXELS = 6000, 4000  # pixels of each stack that are stored, and those on parts
EXPOSURES = ((1.0,), (1.0, 4.0), (0.25, 1.0, 4.0))
FOLDS = 3
CHECKED_RIGS = ("like-phoxi-m", "like-phoxi-l", "like-zivid-2-m70")  # The last made no scene above.
CHECKED = ("matt", "plastic", "metal 0.5", "metal 0.35", "metal 0.2")
CHECK_SEEDS = (3, 4, 5)
LIMITS = (0.9999, 0.1, 0.05, 0.02)  # The first keeps practically all depth.
WITHOUT_RIG = 0.2  # Share of the pixels that are given once more without the cues of a rig.
MIRRORED, MIRRORED_PX = 0.01, (4.0, 400.0)  # Share of mirror images, and distances off the line.
TREES: Mapping[str, Any] = {
    "max_iter": 60,
    "learning_rate": 0.2,
    "max_leaf_nodes": 24,
    "min_samples_leaf": 200,
    "l2_regularization": 1.0,
    "random_state": 0,
}
_OF_RIG = ("epipolar", "sigma of depth", "slope", "handedness", "rival")
OF_RIG = [j for j, name in enumerate(NAMES) if any(word in name for word in _OF_RIG)]


# --- scenes ------------------------------------------------------------------------------------


def random_material(rng: np.random.Generator) -> Material:
    """Return metal, plastic, a matt or a dark surface; metal in three of five cases."""
    kind = str(rng.choice(["metal", "plastic", "matt", "dark"], p=[0.6, 0.2, 0.1, 0.1]))
    grey = float(rng.uniform(0.02, 0.1) if kind == "dark" else rng.uniform(0.2, 0.85))
    color = (grey, grey, grey)
    if kind == "matt":
        return Material(base_color=color, specular=0.0)
    low, high = {"metal": (0.1, 0.6), "plastic": (0.2, 0.6), "dark": (0.3, 0.7)}[kind]
    roughness = float(rng.uniform(low, high))
    return Material(base_color=color, roughness=roughness, metallic=float(kind == "metal"))


def random_heap(scene: Scene, rng: np.random.Generator, *, seed: int) -> tuple[Scene, Layout]:
    """Return a bin of random size and material with a heap of one to three kinds of parts."""
    names = [name for name in ZOO if name != CHECK_PART]
    kinds = [str(rng.choice(names)) for _ in range(int(rng.integers(1, 4)))]
    materials = [random_material(rng) for _ in kinds]
    if rng.random() < 0.5:  # Heaps of one kind of metal have most light from other surfaces.
        materials = materials[:1] * len(kinds)
    parts = tuple(
        replace(zoo_part(kind), name=f"{kind}-{k}", material=material)
        for k, (kind, material) in enumerate(zip(kinds, materials, strict=True))
    )
    box = bin_of(scene)
    x, y, z = (float(side) for side in box.inner_m * rng.uniform(0.75, 1.3, 3))
    box = replace(box, inner_m=(x, y, z))
    if rng.random() < 0.6:
        box = replace(box, material=random_material(rng))
    scene = replace(scene, parts=parts, bin=box)
    count = max(1, int(rng.integers(10, 36)) // len(parts))
    return scene, drop(scene, (count,) * len(parts), seed=seed, limits=DropLimits())


def scanners(own: Scanner, rng: np.random.Generator, codecs: Sequence[Codec]) -> list[Scanner]:
    """Return a rig's preset and scanners with other codes, on one axis or two."""
    others = []
    for codec in codecs:
        axes = AXES if rng.random() < 0.6 else AXES[:1]
        factors = EXPOSURES[int(rng.integers(len(EXPOSURES)))]
        exposure = replace(own.exposure, factors=factors)
        inverses = True if codec == "gray" and rng.random() < 0.5 else None
        code = CodeSpec(codec=codec, axes=axes, inverses=inverses)
        others.append(replace(own, code=code, exposure=exposure))
    return [bare(scanner) for scanner in (own, *others)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pixels:
    """Cues of pixels, and which of their depths are wrong."""

    cues: Float32[np.ndarray, "n cues"]
    wrong: Bool[np.ndarray, " n"]


def simulated(number: int, renderer: Renderer) -> Pixels:
    """Simulate one scene with all its scanners, and return random pixels that have depth."""
    rng = np.random.default_rng([number, 77])
    low = number in LOW
    rig = RIGS[number % len(RIGS)]
    cell = cell_of({"rig": rig, "resolution": "low" if low else "small"})
    scene, layout = random_heap(cell.scene, rng, seed=number)
    codecs = [CODECS[k] for k in rng.permutation(len(CODECS))[:2]] if low else CODECS
    several = scanners(cell.scanner, rng, codecs)
    keys, patterns = shared_patterns(several)
    quality = Quality(samples=32 if low else 64)
    rendering = renderer.render(scene, layout, patterns, quality=quality, seed=number)
    of_stacks = []
    for scanner in several:
        capture, light = pictures_of(scanner, rendering.radiance, keys, seed=number)
        cues, depth = evidence_of(scanner, capture, light)
        true_m = rendering.truth.depth_m
        known = np.isfinite(depth.depth_m) & np.isfinite(true_m)
        part = np.flatnonzero(known & (rendering.truth.instance >= 0))
        own = rng.choice(part, min(PART_PIXELS, len(part)), replace=False)
        rest = np.setdiff1d(np.flatnonzero(known), own)
        own = np.append(own, rng.choice(rest, min(PIXELS - len(own), len(rest)), replace=False))
        wrong = wrong_beside_right(depth, true_m).ravel()[own]
        of_stacks.append((cues.reshape(len(cues), -1)[:, own].T, wrong))
    cues, wrong = (np.concatenate(each) for each in zip(*of_stacks, strict=True))
    return Pixels(cues=cues, wrong=wrong)


def evidence_of(
    scanner: Scanner, capture: Capture, light: Radiance
) -> tuple[Float32[np.ndarray, "cues h w"], DepthMap]:
    """Return the cues of a stack's depths, and the depths with sigma, but without bends."""
    codes, first = decode_capture(scanner, capture, path_noise=light.path_noise)
    levels = levels_of(scanner.sensor)
    cues = cues_of(capture.frames, scanner.light_code(), levels, codes, first, scanner.rig)
    return cues, measure(scanner, capture, path_noise=light.path_noise, bends=False)[1]


def wrong_beside_right(
    depth: DepthMap, true_m: Float32[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Return which depths are wrong if the decoder removes all other wrong depths.

    A surface that bends within a pixel adds to the pixel's sigma. A wrong neighbour looks like such
    a bend and would excuse a wrong depth, but the decoder is to remove this neighbour.

    Args:
        depth: sigma is without bends.
    """
    wrong = depth.is_wrong(true_m)
    still = np.zeros_like(wrong)
    # A bend reaches two pixels along a row or column, so every third pixel can be tried at once.
    for start in np.ndindex(3, 3):
        own = np.zeros_like(wrong)
        own[start[0] :: 3, start[1] :: 3] = wrong[start[0] :: 3, start[1] :: 3]
        alone = depth.without(wrong & ~own, Reason.OUTLIER)
        still |= own & with_depth_term(alone, bend_m(alone)).is_wrong(true_m)
    return still


def simulate(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with open_renderer("mitsuba") as renderer:
        for number in (*LOW, *SMALL):
            file = folder / f"{number:03d}.npz"
            if file.exists():
                continue
            try:
                pixels = simulated(number, renderer)
            except (DropError, ValueError) as error:  # Some heaps do not fit into their bins.
                print(f"scene {number} is left out: {error}", flush=True)
                continue
            np.savez(file, names=NAMES, cues=pixels.cues, wrong=pixels.wrong)
            print(
                f"{file}: {len(pixels.wrong)} pixels, {pixels.wrong.mean():.1%} wrong", flush=True
            )


def stored(folder: Path) -> Iterator[Pixels]:
    """Yield the pixels of each scene.

    Raises:
        SystemExit: a file lacks a cue.
    """
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as content:
            names = list(content["names"])
            if lacking := set(NAMES) - set(names):
                raise SystemExit(f"{file} has no {min(lacking)}: remove it and simulate again")
            own = [names.index(name) for name in NAMES]
            yield Pixels(cues=content["cues"][:, own], wrong=content["wrong"])


# --- table -------------------------------------------------------------------------------------


def fitted(scenes: Sequence[Pixels]) -> HistGradientBoostingClassifier:
    """Fit trees to the pixels of scenes, some of them once more without the cues of a rig."""
    cues = np.concatenate([scene.cues for scene in scenes])
    wrong = np.concatenate([scene.wrong for scene in scenes])
    rng = np.random.default_rng(0)
    again = rng.random(len(cues)) < WITHOUT_RIG
    without = cues[again]
    without[:, OF_RIG] = np.nan
    mirrored = mirror_images(cues[~wrong], rng)
    cues = np.concatenate([cues, without, mirrored])
    wrong = np.concatenate([wrong, wrong[again], np.ones(len(mirrored), dtype=bool)])
    trees = HistGradientBoostingClassifier(monotonic_cst=[cue.sense for cue in CUES], **TREES)
    return trees.fit(cues, wrong)


def mirror_images(
    cues: Float32[np.ndarray, "n cues"], rng: np.random.Generator
) -> Float32[np.ndarray, "m cues"]:
    """Return some right pixels as if they saw their light in a perfect mirror.

    Then the epipolar line is the only evidence. In random heaps this is so rare that the table
    would trust a complete image far off its line.
    """
    off, over_sigma, around, sigma = (
        NAMES.index(name)
        for name in (
            "off the epipolar line",
            "off the epipolar line over sigma",
            "off the epipolar line, around",
            "sigma along",
        )
    )
    coded = np.flatnonzero(np.isfinite(cues[:, off]))
    mirrored = cues[coded[rng.random(len(coded)) < MIRRORED]]
    least, most = np.log2(MIRRORED_PX)
    log2_px = rng.uniform(least, most, len(mirrored))
    mirrored[:, off] = mirrored[:, around] = log2_px
    mirrored[:, over_sigma] = log2_px - mirrored[:, sigma]
    return mirrored


def left_out(scenes: Sequence[Pixels]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the probabilities for each scene from a fit without it and others, and the truth."""
    for fold in range(FOLDS):
        trees = fitted([s for k, s in enumerate(scenes) if k % FOLDS != fold])
        for scene in scenes[fold::FOLDS]:
            yield trees.predict_proba(scene.cues)[:, 1], scene.wrong


def table_of(
    trees: HistGradientBoostingClassifier, scenes: Sequence[Pixels]
) -> dict[str, np.ndarray]:
    """Return the arrays of `wrong.Evidence`; the first tree is one leaf, with the mean log odds."""
    start, nodes = [0], [(-1, float(np.ravel(trees._baseline_prediction)[0]), False, 0)]
    for tree in trees._predictors:
        start.append(len(nodes))
        nodes += _in_pairs(tree[0].nodes, len(nodes))
    cue, limit, lacking, after = zip(*nodes, strict=True)
    right = np.concatenate([scene.cues[~scene.wrong] for scene in scenes])
    return {
        "start": np.array(start, dtype=np.int32),
        "cue": np.array(cue, dtype=np.int16),
        "limit": np.array(limit, dtype=np.float32),
        "lacking": np.array(lacking, dtype=bool),
        "next": np.array(after, dtype=np.int32),
        "typical": np.nanmedian(right, axis=0).astype(np.float32),
    }


def _in_pairs(tree: np.ndarray, first: int) -> list[tuple[int, float, bool, int]]:
    """Return a tree's nodes in an order in which the two children of a node are neighbours.

    Args:
        first: the number of the tree's first node.
    """
    order, nodes = [0], []
    for k in order:  # `order` grows in this loop.
        node = tree[k]
        if node["is_leaf"]:
            nodes.append((-1, float(node["value"]), False, 0))
            continue
        cue, limit = int(node["feature_idx"]), float(node["num_threshold"])
        nodes.append((cue, limit, bool(node["missing_go_to_left"]), first + len(order)))
        order += [int(node["left"]), int(node["right"])]
    return nodes


# --- check -------------------------------------------------------------------------------------


def checked(
    rig: str, renderer: Renderer
) -> Iterator[tuple[list[str], tuple[np.ndarray, np.ndarray]]]:
    """Yield a row of figures for each material, and the probabilities of all depths of parts."""
    cell = cell_of({"count": 20, "rig": rig, "resolution": "small"})
    plain = bare(cell.scanner)
    limited = [replace(plain, decode=replace(plain.decode, max_p_wrong=limit)) for limit in LIMITS]
    several = (limited[0], with_single_limits(cell.scanner), *limited[1:])
    patterns, quality = patterns_of(cell.scanner), Quality(samples=64)
    layouts = {
        seed: drop(cell.scene, (20,), seed=seed, limits=DropLimits()) for seed in CHECK_SEEDS
    }
    for name in CHECKED:
        parts = (replace(cell.scene.parts[0], material=Material(**MATERIALS[name])),)
        scene = replace(cell.scene, parts=parts)
        counts = np.zeros((len(several), 3), dtype=np.int64)  # depths, wrong ones, right ones
        pixels, all_p_wrong, all_wrong = 0, [], []
        for seed, layout in layouts.items():
            rendering = renderer.render(scene, layout, patterns, quality=quality, seed=seed)
            light, truth = rendering.radiance, rendering.truth
            capture = take(cell.scanner, light, seed=seed)
            visible = truth.instance >= 0
            pixels += int(visible.sum())
            unbent = measure(limited[0], capture, path_noise=light.path_noise, bends=False)[1]
            wrong = wrong_beside_right(unbent, truth.depth_m)
            for own, scanner in zip(counts, several, strict=True):
                depth = measure(scanner, capture, path_noise=light.path_noise)[1]
                known = visible & np.isfinite(depth.depth_m)
                off = depth.is_wrong(truth.depth_m)
                own += known.sum(), (known & off).sum(), (known & ~wrong).sum()
            known = visible & np.isfinite(unbent.depth_m)
            assert unbent.p_wrong is not None
            all_p_wrong.append(unbent.p_wrong[known])
            all_wrong.append(wrong[known])
        p_wrong, wrong = np.concatenate(all_p_wrong), np.concatenate(all_wrong)
        cells = [
            f"{100 * own / pixels:.0f}; {100 * off / own:.1f}; {100 * right / counts[0, 2]:.0f}"
            for own, off, right in counts
        ]
        yield [rig, name, *cells, f"{roc_auc(p_wrong, wrong):.3f}"], (p_wrong, wrong)


def check() -> None:
    """Print the tables of docs/measurements/wrong_depth.md."""
    rows, several = [], []
    with open_renderer("mitsuba") as renderer:
        for rig in CHECKED_RIGS:
            for row, depths in checked(rig, renderer):
                rows.append(row)
                several.append(depths)
    limits = [f"`max_p_wrong` {limit:g}" for limit in LIMITS[1:]]
    print(markdown_table(["rig", "material", "no limit", "single limits", *limits, "ROC"], rows))
    bins = reliability(*(np.concatenate(each) for each in zip(*several, strict=True)))
    lines = [[f"{b.mean:.4f}", f"{b.wrong:.4f}", str(b.count)] for b in bins]
    print(markdown_table(["mean probability", "share of wrong depths", "depths"], lines))
    print(f"expected calibration error {calibration_error(bins):.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("step", choices=("scenes", "table", "check"), help="See above.")
    parser.add_argument("folder", type=Path, nargs="?", help="The folder of the simulated pixels.")
    arguments = parser.parse_args()
    if arguments.step == "check":
        check()
        return
    if arguments.folder is None:
        parser.error("give the folder of the simulated pixels")
    if arguments.step == "scenes":
        simulate(arguments.folder)
        return
    scenes = list(stored(arguments.folder))
    p_wrong, wrong = (np.concatenate(each) for each in zip(*left_out(scenes), strict=True))
    print(f"{len(scenes)} scenes, {len(wrong)} pixels, {wrong.mean():.2%} wrong")
    print(f"left out: area under the ROC {roc_auc(p_wrong, wrong):.4f}")
    few = p_wrong <= 0.01
    print(f"p_wrong <= 0.01: {(few & ~wrong).sum() / (~wrong).sum():.1%} of the right depths,")
    print(f"{wrong[few].mean():.2%} of these depths wrong")
    table = table_of(fitted(scenes), scenes)
    target = Path(__file__).resolve().parents[1] / "src/graycast/camera/decode/evidence" / TABLE
    with target.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, names=np.array(NAMES), **table)
    print(f"{target}: {len(table['start'])} trees, {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
