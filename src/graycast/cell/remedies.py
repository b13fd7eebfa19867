"""Settings of a scanner that give the parts of a scene more depth, tried on the scene's light."""

from dataclasses import dataclass, replace

from ..camera.decode import little_depth_note, reason_shares
from ..camera.scanner import Scanner, measure, take
from .metering import bin_region
from .simulate import Shot, on_part


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
        "decode: {min_sigmas: 15}": replace(
            scanner, decode=replace(scanner.decode, min_sigmas=15.0)
        ),
    }
    return tuple(
        Remedy(words=words, scanner=other) for words, other in tries.items() if other != scanner
    )


def depth_note(shot: Shot, scanner: Scanner) -> str:
    """Return why under half of the parts' pixels have depth, and the change that helps most.

    Each change is tried on the light of the scene, without another rendering. The note is empty if
    at least half of the pixels have depth.
    """
    sample = shot.sample
    before = sample.manifest["part_reasons"]
    note = little_depth_note(before)
    if not note:
        return ""
    scanner = replace(scanner, rig=sample.scene.rig)
    part = on_part(sample.scene, sample.layout, sample.truth)
    radiance, region = shot.rendering.radiance, bin_region(sample.scene)
    shares = {}
    for remedy in remedies(scanner):
        capture = take(
            remedy.scanner, radiance, seed=sample.manifest["seeds"]["noise"], metered=region
        )
        _, depth = measure(remedy.scanner, capture, path_noise=radiance.path_noise)
        shares[remedy.words] = reason_shares(depth.reason[part])["decoded"]
    best = max(shares, key=lambda words: shares[words])
    if shares[best] < before["decoded"] + 0.005:
        return f"{note}; none of these changes helps: {'; '.join(shares)}"
    return f"{note}; with `{best}` {shares[best]:.1%} have depth (tried on this scene)"
