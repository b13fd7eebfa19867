"""A small finished dataset of prisms in closed form, with the data that a report needs."""

import json
from dataclasses import replace
from pathlib import Path

from dataset.captured import scanned, toed_in
from dataset.prisms import CONFIG, SCALE_MM, SEED, box_part, build_sample, make_rig, wedge_part

from graycast.camera.scanner import Scanner
from graycast.dataset.write.store import open_store

LENS = (-0.12, 0.05, 0.001, -0.0007, 0.0)
CODE = {
    "codec": "gray",
    "axes": ["column", "row"],
    "base_bit": None,
    "inverses": None,
    "period_px": None,
    "steps": None,
}


def lensed_rig():
    """Return a rig with distortion in both devices; the labels still use a pinhole."""
    rig = make_rig()
    return replace(
        rig,
        camera=replace(rig.camera, distortion=LENS),
        projector=replace(rig.projector, distortion=LENS),
    )


def write_dataset(out: Path, scene_ids=(0, 3), rig=None, *, keeps=False):
    """Write the dataset, return its samples by scene; `keeps` also stores frames and code maps."""
    rig, parts = rig or make_rig(), (box_part(), wedge_part())
    samples = {k: build_sample(k, parts=parts, rig=rig) for k in scene_ids}
    config = CONFIG | {"scanner": {"code": CODE}}
    if keeps:
        scanner = Scanner(rig=toed_in(rig))
        rig = scanner.rig
        samples = {k: scanned(sample, scanner, seed=k) for k, sample in samples.items()}
        config["store"] = {"frames": True, "columns": True}
    with open_store(
        out,
        config=config,
        seed=SEED,
        parts=parts,
        rig=rig,
        depth_scale_mm=SCALE_MM,
    ) as store:
        for scene_id, sample in samples.items():
            store.write(scene_id, [sample])
        store.finish(samples)
    return samples


def forget(out: Path) -> None:
    """Reduce a dataset to the files that a dataset of real pictures has."""
    claim = json.loads((out / "graycast.json").read_bytes())
    claim_keys = ("format_version", "depth_scale_mm", "sources", "versions")
    parts = [{key: part[key] for key in ("obj_id", "name")} for part in claim["parts"]]
    real = {"kind": "real", "parts": parts, "holds": ["rgb", "depth_sl", "masks"]}
    (out / "graycast.json").write_text(json.dumps({key: claim[key] for key in claim_keys} | real))
    for scene in (out / "train").iterdir():
        for name in ("depth", "reason_sl", "gray_sl"):
            (scene / name / "000000.png").unlink()
        (scene / "scene_gt_box3d.json").unlink()
        for name, keys in (
            ("scene_gt", ("obj_id",)),
            ("scene_gt_info", ("bbox_visib", "px_count_visib")),
        ):
            path = scene / f"{name}.json"
            entries = json.loads(path.read_bytes())["0"]
            path.write_text(json.dumps({"0": [{k: e[k] for k in keys} for e in entries]}))
        path = scene / "scene_camera.json"
        view = json.loads(path.read_bytes())["0"]
        path.write_text(json.dumps({"0": {k: view[k] for k in ("cam_K", "depth_scale")}}))
