"""A manifest against the dataset's claim and the scene's own files."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ...base.streams import image_seeds, scene_seeds
from ...camera.decode import reason_shares
from ..claim import BESIDE_CONFIG
from .evidence import Evidence


def manifest_problems(scene: Evidence) -> Iterator[str]:
    """What a manifest says that is not so."""
    facts, claim = scene.manifest_record, scene.claim
    if facts.dataset_seed != claim.seed:
        yield f"manifest.json: dataset_seed is {facts.dataset_seed}, graycast.json has {claim.seed}"
    scene_id, number = int(scene.plain.files.path.name), scene.plain.number
    must = scene_seeds(
        claim.seed, scene_id, domain="domain" in facts.seeds, views="views" in facts.seeds
    )
    must |= image_seeds(claim.seed, scene_id, station=scene.taker, image=number)
    if facts.seeds != must:
        wrong = sorted(k for k in {*facts.seeds, *must} if facts.seeds.get(k) != must.get(k))
        yield f"manifest.json: seeds of {', '.join(wrong)} do not follow from dataset_seed"
    config = {k: v for k, v in claim.config.items() if k not in BESIDE_CONFIG}
    if facts.config != config:
        wrong = sorted(k for k in {*facts.config, *config} if facts.config.get(k) != config.get(k))
        yield f"manifest.json: config differs from graycast.json's in {', '.join(wrong)}"
    names = {part.obj_id: part.name for part in claim.parts}
    lying = Counter(names.get(pose.obj_id, "") for pose in scene.plain.poses)
    if dict(lying) != facts.counts:
        yield f"manifest.json: counts are {facts.counts}, scene_gt.json has {dict(lying)}"
    reason = scene.image["reason_sl"]
    shares = reason_shares(reason)
    for name in sorted({*shares, *facts.reasons}):
        is_, was = shares.get(name, np.nan), facts.reasons.get(name, np.nan)
        if not abs(is_ - was) < 0.5 / reason.size:
            yield f"manifest.json: the share of {name} is {was}, that of reason_sl {is_}"
