"""Random numbers in independent streams, each derived from a seed and a key.

A stream is identified by its number or by its index in a tuple, so a change in one stream does not
affect the others, and new streams are added at the end. If a stream belongs to one of several
scanners, its key contains the scanner's index in the configuration or its name, so scanners do not
share random numbers. The first scanner has the same random numbers as a cell's only scanner.
"""

from enum import IntEnum

import numpy as np

# `SCENE` names the random streams of a scene, `OF_IMAGE` those of each further image; the first
# image uses the streams of its scene.
SCENE = ("counts", "drop", "render", "noise", "picture", "domain", "views")
OF_IMAGE = ("render", "noise", "picture")
_RESCAN = 1 << 31  # This number replaces the index of a scanner, which is always smaller.
DOMAIN = ("camera", "bin", "lamps", "environment", "table", "parts", "counts", "distractors")
EMPTIED_BIN = ("counts", "drop", "calibration", "attempts")  # A robot's seed has these streams.


class CaptureStream(IntEnum):
    """Streams of the seed with which pictures are taken; the noise of a shot uses the seed itself.

    `FIXED_PATTERN` is a stream of the sensor's seed, which may be the same number.
    """

    FIXED_PATTERN = 1
    SPECKLE = 2
    LINES = 3
    FINISH = 4


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return a generator for a seed and a key; different keys give independent random numbers."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def station_stream(seed: int, station: int) -> np.random.Generator:
    """Return a generator of a scanner's own random numbers, from a seed that all scanners share.

    Args:
        station: the scanner's index in the configuration; 0 gives the numbers of the seed itself.
    """
    return stream(seed, *([station] if station else []))


def device_seed(seed: int, name: str) -> int:
    """Return the seed of a device, derived from the seed of its model and the device's name."""
    own = np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))
    return int(own.generate_state(1)[0])


def scene_seeds(
    seed: int, scene_id: int, *, domain: bool = False, views: bool = False
) -> dict[str, int]:
    """Return the seed of each stage of a scene and of its first image.

    Args:
        domain: whether values of a domain are drawn at random; only then do they have a seed.
        views: whether the viewpoints of images are drawn at random; only then do they have a seed.
    """
    seeds = _seeds(seed, (scene_id,), SCENE)
    # A scene without random values of a domain or of views has no seed for them.
    left_out = {name for name, has in (("domain", domain), ("views", views)) if not has}
    return {name: value for name, value in seeds.items() if name not in left_out}


def image_seeds(seed: int, scene_id: int, *, station: int, image: int) -> dict[str, int]:
    """Return the seeds of an image's own stages; the first image has the seeds of the scene.

    Args:
        station: the scanner's index in the configuration.
        image: the image's index among the scanner's images.
    """
    if station == image == 0:
        first = scene_seeds(seed, scene_id)
        return {name: first[name] for name in OF_IMAGE}
    return _seeds(seed, (scene_id, station, image), OF_IMAGE)


def rescan_seeds(seed: int, scene_id: int, *, scanner: str, image: int) -> dict[str, int]:
    """Return the seeds of an image that another scanner takes of a stored scene.

    No image of a dataset with the same seed, and no other scanner's rescan, has the same seeds.

    Args:
        scanner: the name of the rig, with that of the camera if the source has several cameras.
        image: the number of the image that is scanned again.
    """
    return _seeds(seed, (scene_id, _RESCAN, image, *scanner.encode()), OF_IMAGE)


def _seeds(seed: int, key: tuple[int, ...], names: tuple[str, ...]) -> dict[str, int]:
    state = np.random.SeedSequence(seed, spawn_key=key).generate_state(len(names), np.uint64)
    return dict(zip(names, map(int, state), strict=True))
