"""First pass over all pictures of an import: checks, the depth step, and warnings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.errors import DatasetError
from ...rig.optics import optics_of, picture_rays
from ..depth_file import FileOptions
from ..depth_sense import depth_kind_note, filled_holes, plane_shares, refuse_beyond
from ..picture_pairs import RealPicture, ShotData, depth_step_mm, is_whole, read_shot

_USUAL = 0.99  # share of each picture's depth that counts as usual
_COARSER = 5.0  # A note is given if the other pixels make the depth step this many times coarser.
_FOR_KIND = 20  # number of pictures tested for z or ray length


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """The first picture, whose properties all pictures share, the depth step, and notes."""

    first: ShotData
    step_mm: float
    notes: tuple[str, ...]


def survey(
    shots: Sequence[RealPicture],
    files: FileOptions,
    *,
    range_m: tuple[float, float] | None,
) -> Survey:
    """Read all pictures, so that errors are reported before anything is written.

    Args:
        range_m: see `import_real`.

    Raises:
        DatasetError: a picture cannot be used, or differs in form from the first picture.
    """
    first: ShotData | None = None
    notes: list[str] = []
    largest: dict[RealPicture, int] = {}
    beyond: dict[RealPicture, int] = {}
    deepest: tuple[float, RealPicture] = (0.0, shots[0])
    usual_m = 0.0
    sample: list[np.ndarray] = []
    for shot in shots:
        images = read_shot(shot, files)
        first = first or images
        _refuse_unlike(shot, images, shots[0], first)
        if images.depth_m is None:
            continue
        _refuse_out_of_range(shot, images, range_m)
        known_m = images.depth_m[np.isfinite(images.depth_m)]
        usual_m = max(usual_m, float(np.quantile(known_m, _USUAL)))
        deepest = max(deepest, (float(known_m.max()), shot), key=lambda pair: pair[0])
        largest |= {shot: images.largest_px} if images.largest_px else {}
        beyond |= {shot: images.beyond_px} if images.beyond_px else {}
        sample += [images.depth_m] if len(sample) < _FOR_KIND else []
        if note := filled_holes(images.depth_m, str(shot.depth)):
            notes.append(note)
    assert first is not None  # there is at least one picture
    paths = [shot.depth for shot in shots if shot.depth is not None]
    scale_m = files.scale_m if paths and all(is_whole(path) for path in paths) else None
    step_mm = depth_step_mm(deepest[0], scale_m)
    notes += _pixel_notes(largest, "have the largest number of the file's type, which is no "
                                   "distance")  # fmt: skip
    notes += _pixel_notes(beyond, f"lie beyond --max-depth {files.max_depth_m} m")
    if usual_m > 0:
        notes += _step_notes(deepest, step_mm, usual_m, depth_step_mm(usual_m, scale_m))
    if sample:
        optics = optics_of(first.K, first.size_px, files.distortion or (0.0,) * 5)
        # --ray-length has converted the depth to z, but the test needs the values of the files.
        per_z = np.linalg.norm(picture_rays(optics), axis=-1) if files.ray_length else 1.0
        shares = plane_shares([depth_m * per_z for depth_m in sample], optics)
        if note := depth_kind_note(shares, ray_length=files.ray_length):
            notes.append(note)
    return Survey(first=first, step_mm=step_mm, notes=tuple(notes))


def _refuse_unlike(
    shot: RealPicture, images: ShotData, first_shot: RealPicture, first: ShotData
) -> None:
    if images.size_px != first.size_px or images.holds != first.holds:
        is_, was = (
            f"{s.size_px[1]} x {s.size_px[0]} pixels with {', '.join(s.holds)}"
            for s in (images, first)
        )
        raise DatasetError(
            f"{shot.stem}: is {is_}; {first_shot.stem} is {was}: give pictures of one camera"
        )


def _refuse_out_of_range(
    shot: RealPicture, images: ShotData, range_m: tuple[float, float] | None
) -> None:
    if range_m is None or images.depth_m is None:
        return
    near_m, far_m = range_m
    whose = "the scanner of the dataset of --like measures"
    refuse_beyond(images.depth_m, near_m=near_m, far_m=far_m, name=str(shot.depth), whose=whose)


def _pixel_notes(pixels: dict[RealPicture, int], what: str) -> Iterator[str]:
    if pixels:
        worst = max(pixels, key=lambda shot: pixels[shot])
        yield (
            f"{sum(pixels.values())} pixels in {len(pixels)} pictures {what}: they are stored "
            f"without depth (the most, {pixels[worst]}, in {worst.depth})"
        )


def _step_notes(
    deepest: tuple[float, RealPicture], step_mm: float, usual_m: float, usual_mm: float
) -> Iterator[str]:
    """Yield a note with a remedy if a few far pixels make the depth step coarse."""
    if step_mm < _COARSER * usual_mm:
        return
    deepest_m, shot = deepest
    yield (
        f"depth is stored in steps of {step_mm:g} mm because {shot.depth} has a pixel at "
        f"{deepest_m:.4g} m: {_USUAL:.0%} of the depth of each picture lies within {usual_m:.3g} "
        f"m, for which {usual_mm:g} mm would do: to leave out what is farther, give --max-depth "
        f"{np.floor(65.5 * usual_mm * 100) / 100:g}"
    )
