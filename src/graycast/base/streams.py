"""Random numbers in independent streams, each derived from a seed and a key.

A stream is known by its number or by its place in a tuple, so that a change in one leaves the
others as they were: new ones go last. What belongs to one of several scanners has the scanner's
place in the configuration, or its name, in its key: no two scanners share random numbers. The first
one has those of a cell with one scanner.
"""

from enum import IntEnum

import numpy as np

# `SCENE` are the streams of a dataset's seed; each image has its own streams `OF_IMAGE`.
SCENE = ("counts", "drop", "render", "noise", "picture", "domain", "views")
OF_IMAGE = ("render", "noise", "picture")
_RESCAN = 1 << 31  # It replaces the index of a scanner, which is always smaller.
DOMAIN = ("camera", "bin", "lamps", "environment", "table", "parts", "counts", "distractors")
EMPTIED_BIN = ("counts", "drop", "calibration", "attempts")  # A robot's seed has these.


class CaptureStream(IntEnum):
    """Streams of the seed with which pictures are taken; a shot's own noise has none of them.

    `FIXED_PATTERN` is of the sensor's seed, which may be the same number.
    """

    FIXED_PATTERN = 1
    SPECKLE = 2
    LINES = 3
    FINISH = 4


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random numbers of a seed's stream: other keys give independent ones."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def station_stream(seed: int, station: int) -> np.random.Generator:
    """Return a scanner's own random numbers of a seed that all scanners share.

    Args:
        station: the scanner's place in the configuration; the first has the numbers of the seed.
    """
    return stream(seed, *([station] if station else []))


def device_seed(seed: int, name: str) -> int:
    """Return the seed of a device that is known by its name, from the seed of its model."""
    own = np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))
    return int(own.generate_state(1)[0])


def scene_seeds(
    seed: int, scene_id: int, *, domain: bool = False, views: bool = False
) -> dict[str, int]:
    """Return the seed of each stage of a scene and of its first image.

    Args:
        domain: whether values are drawn from one; else there is no seed of it.
        views: likewise of the places that images are taken from.
    """
    seeds = _seeds(seed, (scene_id,), SCENE)
    # A scene without random values of a domain or of views has no seed for them.
    left_out = {name for name, has in (("domain", domain), ("views", views)) if not has}
    return {name: value for name, value in seeds.items() if name not in left_out}


def image_seeds(seed: int, scene_id: int, *, station: int, image: int) -> dict[str, int]:
    """Return the seeds of one image's own stages; those of the first image are the scene's.

    Args:
        station: the scanner's place in the configuration.
        image: which of the scanner's images it is.
    """
    if station == image == 0:
        first = scene_seeds(seed, scene_id)
        return {name: first[name] for name in OF_IMAGE}
    return _seeds(seed, (scene_id, station, image), OF_IMAGE)


def rescan_seeds(seed: int, scene_id: int, *, scanner: str, image: int) -> dict[str, int]:
    """Return the seeds of an image that another scanner takes of a stored scene.

    They are those of no image of a dataset with the same seed, and of no other scanner's rescan.

    Args:
        scanner: the name of the rig, and of the source's camera if that has several.
        image: the number of the image that is scanned again.
    """
    return _seeds(seed, (scene_id, _RESCAN, image, *scanner.encode()), OF_IMAGE)


def _seeds(seed: int, key: tuple[int, ...], names: tuple[str, ...]) -> dict[str, int]:
    state = np.random.SeedSequence(seed, spawn_key=key).generate_state(len(names), np.uint64)
    return dict(zip(names, map(int, state), strict=True))
