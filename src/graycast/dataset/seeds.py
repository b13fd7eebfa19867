"""The seeds of a scene's stages, which follow from the dataset's seed and the scene's number."""

import numpy as np

# One independent stream per stage, so that a change in one leaves the others as they were: they
# are known by their places, so new ones go last.
STREAMS = ("counts", "drop", "render", "noise", "picture", "domain")


def scene_seeds(seed: int, scene_id: int, *, domain: bool) -> dict[str, int]:
    """The seed of each stage; without a domain none is drawn from one."""
    sequence = np.random.SeedSequence(seed, spawn_key=(scene_id,))
    state = sequence.generate_state(len(STREAMS), np.uint64)
    seeds = dict(zip(STREAMS, map(int, state), strict=True))
    if not domain:
        del seeds["domain"]  # manifests stay as they were before there were domains
    return seeds
