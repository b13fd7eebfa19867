"""The twin of five real scans for docs/measurements/detection.md and docs/measurements/twin.md.

python -m studies.phoxi_twin --out out/phoxi
graycast generate out/phoxi/twin.yaml --out out/phoxi/twin
graycast detector study out/phoxi/study.yaml --out out/phoxi/study

The first command writes the twin's configuration, the scans as a dataset, and `cell.yaml` for
`graycast real twin`. The last one trains in the twin on four inputs, and scores on the twin and on
the scans. `rescanned.yaml` is the study of the page's rescans, for 140 scenes:

graycast rescan out/phoxi/twin/train --rig out/phoxi/rig.yaml --out out/phoxi/rescanned
graycast rescan out/phoxi/twin/train --rig out/phoxi/rig.yaml --materials out/phoxi/bin.yaml \\
    --out out/phoxi/rescanned_bin

Bin, household meshes and scans are in ../shared/data, which does not belong to the project.
"""

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import trimesh
import yaml
from pycocotools import mask as coco_mask

from benchmarks.zoo_parts import zoo_part
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner, preset
from graycast.cell.config import BinSection, resolve_bin
from graycast.real.depth_file import FileOptions
from graycast.real.fit_bin.bending import bent_bin, mesh_bytes
from graycast.real.fit_bin.bin_views import BinView, empty_view
from graycast.real.import_real import import_real
from graycast.rig.optics import Optics

from .printed_cartons import printed_carton
from .random_shapes import random_shape

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = DATA / "phoxi"
# Measured values of the device (README.md of the scans); the projector is left of the camera.
BASELINE_M, TOE_IN_DEG, NEAR_M, FAR_M = 0.235, 8.4, 0.6, 1.0
FX_PX, CX_PX, CY_PX, SIZE_PX = 552.5, 255.5, 191.75, (516, 386)
# Tangents of the projector's outermost rays. In all scans, depth ends at straight lines on the
# left, on the right and at the top. At the bottom, the camera's picture ends first.
LIT_X, LIT_Y = (-0.4161, 0.4225), (-0.3135, 0.4)
T_BIN_CAM = [
    [-0.989165430, 0.00623583812, 0.146672650, -0.120568007],
    [0.00614760043, 0.999980547, -0.00105488641, 0.000705997615],
    [-0.146676374, -0.000141772325, -0.989184523, 0.818108786],
    [0.0, 0.0, 0.0, 1.0],
]
CARTONS = 40  # a third of the parts, as in the scans
SLIPPERY = 0.15
# Families of the zoo for clutter without cartons. The factor scales small parts to the size of
# household objects.
FAMILIES = {
    "hook": 1.5,
    "tee": 1.5,
    "elbow": 1.5,
    "gear": 1.2,
    "o_ring": 2.0,
    "tube": 2.0,
    "cable_clip": 4.0,
    "sheet_bracket": 2.0,
    "hex_bolt": 4.0,
    "shaft": 0.5,
    "bottle": 1.0,
    "spring": 3.0,
    "socket_screw": 8.0,
    "washer": 4.0,
}


def scanner() -> Scanner:
    """Return the PhoXi's twin: the preset with the measured geometry."""
    known = preset("like-phoxi-m", "small")
    toe_in_rad = np.radians(TOE_IN_DEG)
    T_rig_cam = rigid(axis_rotation("y", -toe_in_rad), np.array([BASELINE_M / 2, 0.0, 0.0]))
    T_rig_proj = rigid(axis_rotation("y", toe_in_rad), np.array([-BASELINE_M / 2, 0.0, 0.0]))
    camera = replace(
        known.rig.camera, fx_px=FX_PX, fy_px=FX_PX, cx_px=CX_PX, cy_px=CY_PX, focus_m=0.78
    )
    (fx_px, cx_px), (fy_px, cy_px) = (
        _lens(size, lit)
        for size, lit in (
            (known.rig.projector.width_px, LIT_X),
            (known.rig.projector.height_px, LIT_Y),
        )
    )
    projector = replace(known.rig.projector, fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px)
    rig = replace(
        known.rig,
        name="phoxi-twin",
        camera=camera,
        projector=projector,
        T_cam_proj=inverse(T_rig_cam) @ T_rig_proj,
        near_m=NEAR_M,
        far_m=FAR_M,
        picture_level=0.0,
    )
    return replace(known, rig=rig)


def _lens(size_px: int, lit: tuple[float, float]) -> tuple[float, float]:
    """Return focal length and principal point of a picture between two rays."""
    focal_px = size_px / (lit[1] - lit[0])
    return focal_px, -lit[0] * focal_px - 0.5


def configuration(meshes: Path, shapes: int) -> dict:
    """Return a cell of parts and random shapes in the real bin, repainted in most scenes."""
    rng = np.random.default_rng(0)
    parts = []
    for file in sorted((DATA / "meshes" / "kit").glob("*.stl")):
        parts.append(painted_part(file, "m", rng))
    for name, factor in FAMILIES.items():
        mesh = zoo_part(name).mesh
        file = meshes / f"{name}.stl"
        trimesh.Trimesh(mesh.vertices_m * factor, mesh.faces, process=False).export(file)
        parts.append(painted_part(file, "m", rng))
    for seed in range(shapes):
        file = meshes / f"shape_{seed:02d}.stl"
        random_shape(seed).export(file)
        parts.append(painted_part(file, "m", rng))
    for name in ("hygiene_spray", "toothpaste", "metal_workpiece_1", "metal_workpiece_2"):
        parts.append({"builtin": name})
    return {
        "parts": parts,
        "mix": True,
        "count": [12, 30],
        "scenes": 400,
        "rig": "rig.yaml",
        "bin": {
            "mesh": str(REAL / "bin.obj"),
            "unit": "m",
            # The bin is so dark and smooth that steep walls lose depth. In the scans, they lose it
            # in 40 to 90 % of their pixels. A detector learns to tell such holes from edges.
            "material": {"base_color": [0.02, 0.02, 0.022], "roughness": 0.4},
        },
        "exposure": {"factors": [1.0, 6.0]},
        "decode": {"min_contrast": 0.05},
        "view": {"T_world_cam": [float(value) for row in T_BIN_CAM for value in row]},
        "light": {"environment": {"radiance": [0.05, 0.05, 0.05]}},
        "domain": {
            "kind": "randomized",
            "camera": None,
            "bin": None,
            "table": None,
            "parts": {
                "brightness": [0.4, 1.6],
                "roughness": [-0.2, 0.3],
                "repainted_share": 0.7,
                "color": {"saturation": [0.0, 1.0], "value": [0.05, 0.95]},
            },
            "count_share": [0.5, 1.0],
            "distractors": None,
        },
    }


def write_bent_bin(camera: Optics, scans: list[int], file: Path) -> list[float]:
    """Write the bin with walls bent as in these scans; return the camera's pose, row by row."""
    plain = resolve_bin(BinSection(mesh=REAL / "bin.obj", unit="m"), REAL)[0]
    views = []
    for i in scans:
        depth_m = np.load(REAL / f"depth_{i}.npy")[..., 0].astype(np.float64)
        depth_m[depth_m == 0] = np.nan
        views.append(BinView(name=f"depth_{i}", camera=camera, depth_m=depth_m))
    bent = bent_bin(plain, np.array(T_BIN_CAM), [empty_view(views)])
    file.write_bytes(mesh_bytes(bent.mesh))
    return [float(value) for value in bent.T_world_cam.ravel()]


def cell_to_fit(known: dict, cartons: list[Path], bin_file: Path, T_world_cam: list[float]) -> dict:
    """Return the cell for `graycast real twin`: preset values to fit, and pictures of low noise.

    The search simulates the scenes of the scans; the parts are for scenes that are generated later.
    They are like those of the scans: a third are printed cartons, mostly white (noise on white
    paper is a quarter of that on the dark bin), and most parts keep their own colours. They are in
    the middle, cover a quarter of the picture and mostly lie flat: with little friction, hardly any
    carton leans on others. The walls have the slopes of the real walls. This is necessary since a
    classifier sees the share of floor squares, their slope and their brightness.

    All scenes have the same light, since random lamps would add noise that the scanner lacks.
    """
    fitted = {key: value for key, value in known.items() if key not in ("exposure", "decode")}
    domain = known["domain"] | {"lamps": None, "environment": None}
    domain["parts"] = domain["parts"] | {"brightness": [0.7, 1.2], "repainted_share": 0.3}
    printed = [{"mesh": str(file), "unit": "m", "density_kg_m3": 500} for file in cartons]
    parts = [part | {"friction": SLIPPERY} for part in (*known["parts"], *printed)]
    own = {"rig": "cell_rig.yaml", "render": {"samples": 128}, "domain": domain, "parts": parts}
    own |= {"bin": known["bin"] | {"mesh": str(bin_file), "friction": SLIPPERY}}
    own |= {"view": {"T_world_cam": T_world_cam}}
    return fitted | own | {"count": [8, 20], "drop": {"attempts": 10, "opening_share": 0.6}}


def write_cartons(meshes: Path, count: int) -> list[Path]:
    """Write `count` cartons as files that contain their textures."""
    files = [meshes / f"carton_{seed:02d}.glb" for seed in range(count)]
    for seed, file in enumerate(files):
        printed_carton(seed).export(file)
    return files


def every_second_pixel(known: Scanner) -> Scanner:
    """Return the scanner with pixels of which only a quarter of the area is sensitive.

    The scans contain every second pixel of the device. Its lens blurs by more than one such pixel.
    """
    camera = replace(known.rig.camera, fill_factor=0.25, psf_px=0.35)
    return replace(known, rig=replace(known.rig, name="phoxi-cell", camera=camera))


def painted_part(file: Path, unit: str, rng: np.random.Generator) -> dict:
    """Return the settings of a part with a random colour and roughness."""
    color = [round(float(c), 3) for c in rng.uniform(0.02, 0.8, 3)]
    return {
        "mesh": str(file),
        "unit": unit,
        "material": {"base_color": color, "roughness": round(float(rng.uniform(0.2, 0.8)), 2)},
        "density_kg_m3": 500,
    }


def write_real(out: Path) -> None:
    """Write the real scans as a dataset of one class, at the size of their depth.

    Depth has every second pixel of the device's picture, so colour and masks are made half as wide.
    """
    source = out / "real_pictures"
    for folder in (source, out / "real"):  # remove the results of an earlier call
        shutil.rmtree(folder, ignore_errors=True)
    for name in ("rgb", "depth", "annotations"):
        (source / name).mkdir(parents=True, exist_ok=True)
    for i in range(5):
        color = cv2.imread(str(REAL / f"color_{i}.png"))
        small = cv2.resize(color, SIZE_PX, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(source / "rgb" / f"{i}.png"), small)
        depth_m = np.load(REAL / f"depth_{i}.npy")[..., 0].astype(np.float32)
        np.save(source / "depth" / f"{i}.npy", np.where(depth_m > 0, depth_m, np.nan))
    drafts = json.loads((REAL / "instances_draft.json").read_text())
    for image in drafts["images"]:
        image |= {"file_name": f"{image['id']}.png", "width": SIZE_PX[0], "height": SIZE_PX[1]}
    for entry in drafts["annotations"]:
        mask = coco_mask.decode(entry["segmentation"])
        small = cv2.resize(mask.astype(np.float32), SIZE_PX, interpolation=cv2.INTER_AREA) > 0.5
        run = coco_mask.encode(np.asfortranarray(small.astype(np.uint8)))
        run = {"size": run["size"], "counts": run["counts"].decode()}
        entry |= {"segmentation": run, "bbox": coco_mask.toBbox(run).tolist()}
        entry["area"] = int(small.sum())
    (source / "annotations" / "draft.json").write_text(json.dumps(drafts), encoding="utf-8")
    K = np.array([[FX_PX, 0, CX_PX], [0, FX_PX, CY_PX], [0, 0, 1]])
    import_real(source, out / "real", files=FileOptions(K=K))


STUDY = {
    "title": "Five real scans: detectors trained in the twin",
    "models": [
        {"model": "yolov3", "backbone": "mobilenet-v3-small", "epochs": 40},
        {"model": "mask-rcnn", "backbone": "resnet18"},
    ],
    "inputs": ["depth_sl", "depth", "depth_noisy", "rgb"],
    "training": {"twin": ["twin"]},
    "tests": {
        "own": {"datasets": ["twin"], "split": "test"},
        "real": {"datasets": ["real"]},
    },
    "gap": ["own", "real"],
    "one_class": True,
    "epochs": 20,
    "longest_px": 384,
}


RESCANNED = {
    "title": "Perfect depth, scanner depth and rescanned depth of one set of scenes",
    "models": [{"model": "mask-rcnn", "backbone": "resnet18"}],
    "inputs": ["depth_sl", "depth"],
    "training": {
        "generated": ["twin"],
        "rescanned": ["rescanned/train"],
        "rescanned_bin": ["rescanned_bin/train"],
    },
    "tests": {"real": {"datasets": ["real"]}},
    "split": [0.9, 0.1, 0.0],
    "one_class": True,
    "epochs": 14,
    "longest_px": 320,
}


def refuse_without_data() -> None:
    """End the program if the scans and meshes are missing."""
    needed = (REAL / "bin.obj", REAL / "instances_draft.json", DATA / "meshes" / "kit")
    missing = [str(path) for path in needed if not path.exists()]
    if missing:
        raise SystemExit(
            f"{missing[0]} is missing: put the scans and meshes, which are no part of "
            "the project, into ../shared/data beside the repository"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--shapes", type=int, default=42, help="The number of random shapes among the parts."
    )
    parser.add_argument(
        "--scans",
        type=int,
        nargs="+",
        choices=range(5),
        default=[0, 1, 2, 3, 4],
        help="The numbers of the scans that the bin of cell.yaml is bent to. Name those that "
        "`graycast real twin` fits, and the other scans stay unseen.",
    )
    arguments = parser.parse_args()
    out = arguments.out
    refuse_without_data()
    meshes = (out / "meshes").absolute()
    meshes.mkdir(parents=True, exist_ok=True)
    save_scanner(scanner(), out / "rig.yaml")
    save_scanner(every_second_pixel(scanner()), out / "cell_rig.yaml")
    content = configuration(meshes, arguments.shapes)
    bin_file = meshes / "bin.ply"
    pose = write_bent_bin(scanner().rig.camera, arguments.scans, bin_file)
    cell = cell_to_fit(content, write_cartons(meshes, CARTONS), bin_file, pose)
    written = {"twin.yaml": content, "cell.yaml": cell, "study.yaml": STUDY}
    written |= {"rescanned.yaml": RESCANNED, "bin.yaml": {"background": content["bin"]["material"]}}
    for name, value in written.items():
        (out / name).write_text(yaml.safe_dump(value, sort_keys=False), encoding="utf-8")
    write_real(out)


if __name__ == "__main__":
    main()
