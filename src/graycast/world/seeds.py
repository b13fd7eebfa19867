"""The seeds of a scene's stages, which follow from the dataset's seed and the scene's number."""

import numpy as np

# One independent stream per stage, so that a change in one leaves the others as they were: they
# are known by their places, so new ones go last.
STREAMS = ("counts", "drop", "render", "noise", "picture", "domain", "views")
OF_IMAGE = ("render", "noise", "picture")  # these each image has of its own


def scene_seeds(
    seed: int, scene_id: int, *, domain: bool = False, views: bool = False
) -> dict[str, int]:
    """The seed of each stage of a scene and of its first image.

    Args:
        domain: whether values are drawn from one; else there is no seed of it.
        views: likewise of the places that images are taken from.
    """
    seeds = _drawn(seed, (scene_id,), STREAMS)
    # Manifests stay as they were before there were domains and views.
    left_out = {name for name, has in (("domain", domain), ("views", views)) if not has}
    return {name: value for name, value in seeds.items() if name not in left_out}


def image_seeds(seed: int, scene_id: int, *, station: int, image: int) -> dict[str, int]:
    """The seeds of one image's own stages: of the first, those of its scene.

    Args:
        station: the scanner's place in the configuration.
        image: which of the scanner's images it is.
    """
    if station == image == 0:
        first = scene_seeds(seed, scene_id)
        return {name: first[name] for name in OF_IMAGE}
    return _drawn(seed, (scene_id, station, image), OF_IMAGE)


def _drawn(seed: int, key: tuple[int, ...], names: tuple[str, ...]) -> dict[str, int]:
    state = np.random.SeedSequence(seed, spawn_key=key).generate_state(len(names), np.uint64)
    return dict(zip(names, map(int, state), strict=True))
