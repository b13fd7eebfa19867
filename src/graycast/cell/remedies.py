"""Settings of a scanner that give the parts of a scene more depth, tried on the scene's light."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ..camera.decode import WRONG_M, WRONG_SIGMAS, DepthMap, little_depth_note
from ..camera.scanner import Scanner, measure, take
from .metering import metered_region
from .simulate import Shot, on_part

LEAST_GAIN = 0.005  # A change must give this share more of the parts' pixels depth; our choice.
MORE_WRONG = 0.005  # A change may raise the share of wrong depths by this much; our choice.


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthShares:
    """Share of the parts' pixels that have depth, and share of these depths that are wrong."""

    depth: float
    wrong: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """A change of a scanner, as written in a configuration, and the changed scanner."""

    words: str
    scanner: Scanner


def remedies(scanner: Scanner) -> tuple[Remedy, ...]:
    """Return the changes to try, without those that the scanner already has."""
    exposure = scanner.exposure
    tries = {
        "exposure: {auto: true}": replace(scanner, exposure=replace(exposure, auto=True)),
        "exposure: {factors: [0.05, 0.5, 4, 30]}": replace(
            scanner, exposure=replace(exposure, auto=False, factors=(0.05, 0.5, 4.0, 30.0))
        ),
        "decode: {max_p_wrong: 0.2}": replace(
            scanner,
            decode=replace(scanner.decode, max_p_wrong=max(0.2, scanner.decode.max_p_wrong)),
        ),
    }
    return tuple(
        Remedy(words=words, scanner=other) for words, other in tries.items() if other != scanner
    )


def depth_shares(
    depth: DepthMap, true_m: Float[np.ndarray, "h w"], part: Bool[np.ndarray, "h w"]
) -> DepthShares:
    """Return the depth shares of the parts' pixels."""
    known = part & np.isfinite(depth.depth_m)
    wrong = depth.is_wrong(true_m)[known]
    return DepthShares(
        depth=float(known.sum() / max(part.sum(), 1)),
        wrong=float(wrong.mean()) if wrong.size else 0.0,
    )


def advice(now: DepthShares, tries: Mapping[str, DepthShares]) -> str:
    """Return a text on the wrong depths and on the change that adds most depth but few wrong ones.

    A change that adds even more depth, but also more wrong depths, is named with both shares.

    Args:
        tries: the shares after each change, by the change's words.
    """
    limits = f"over {1e3 * WRONG_M:g} mm and {WRONG_SIGMAS:g} sigma off"
    words, most = [f"now {now.wrong:.1%} of the depths are wrong ({limits})"], 0.0
    gains = {words: each for words, each in tries.items() if each.depth >= now.depth + LEAST_GAIN}
    if not gains:
        return f"{words[0]}; none of these changes gives more depth: `{'`, `'.join(tries)}`"
    true = {words: each for words, each in gains.items() if each.wrong <= now.wrong + MORE_WRONG}
    if true:
        best = max(true, key=lambda words: true[words].depth)
        most = true[best].depth
        words.append(f"with `{best}` {most:.1%} have depth, {true[best].wrong:.1%} of it wrong")
    greedy = max(gains, key=lambda words: gains[words].depth)
    if gains[greedy].depth > most:
        shares = gains[greedy]
        words.append(
            f"`{greedy}` is no remedy: {shares.depth:.1%} have depth, but {shares.wrong:.1%} of it "
            "is wrong"
        )
    return f"{'; '.join(words)} (tried on this scene)"


def depth_note(shot: Shot, scanner: Scanner) -> str:
    """Return why fewer than half of the parts' pixels have depth, and the change that helps most.

    Each change is tried on the light of the scene, without another rendering. The note is empty if
    at least half of the pixels have depth.
    """
    sample = shot.sample
    note = little_depth_note(sample.manifest["part_reasons"])
    if not note:
        return ""
    scanner = replace(scanner, rig=sample.scene.rig)
    part = on_part(sample.scene, sample.layout, sample.truth)
    radiance, true_m = shot.rendering.radiance, sample.truth.depth_m
    tries = {}
    for remedy in remedies(scanner):
        capture = take(
            remedy.scanner,
            radiance,
            seed=sample.manifest["seeds"]["noise"],
            metered=metered_region(sample.scene, remedy.scanner.exposure),
        )
        _, depth = measure(remedy.scanner, capture, path_noise=radiance.path_noise)
        tries[remedy.words] = depth_shares(depth, true_m, part)
    return f"{note}; {advice(depth_shares(sample.scanner_depth, true_m, part), tries)}"
