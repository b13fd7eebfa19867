"""The other world of docs/measurements/detection.md: another scanner and cell, the same parts.

python -m studies.draw_other_world     writes configs/paper/other_world/

Detectors that were trained in one simulated world are scored in this one, for which no setting was
tuned. It stands for a real cell whose kind is known when the simulation is set up, but not its
numbers. It is drawn once. A change here makes another world, whose figures cannot be compared with
earlier ones.

Values are drawn uniformly unless stated otherwise (log: uniform in the logarithm):

camera          focal length 0.92 to 1.08 of the paper's, principal point +-4 px, k1 -0.08 to -0.02,
                k2 0 to 0.03, p1 and p2 +-0.0005, f/3.5 to f/6
projector       1280 x 800 px, focal length 1350 to 1500 px, k1 -0.03 to 0.03, stop 3 to 6 mm, red
rig             baseline 0.30 to 0.40 m, axes cross at 0.85 to 1.0 m, vertical offset +-5 mm,
                roll between both +-0.5 deg
code            Gray and phase, period 40 px, three steps (the paper's: plain Gray)
sensor          read noise 5 to 9 e (log), gain 0.15 to 0.3 DN/e, 12 bit, PRNU 0.5 to 1.5 %,
                DSNU 1 to 4 e, white frame exposed to 0.6 to 0.75
view            1.0 to 1.08 times as far, tilt 3 to 8 deg, azimuth 10 to 30 deg either way
light           one or two lamps at 1.2 to 2 m, 40 to 75 deg high, edge 0.15 to 0.5 m, 0.05 to 0.3
                W/m2 and band, 3000 to 6000 K; a room as a picture: a window, two lamps
bin             each length +-3 %; wood of other grain, tint and darkness; table 0.15 to 0.5 grey
parts           size +-0.5 %, print: each band's exponent 0.85 to 1.2 and gain 0.8 to 1.0, grain
                of 2 %; roughness +-0.1; metal: reflectance 0.7 to 1.5 (log), roughness 0.35 to 0.6
scene           adapted: the product's default tolerances of a cell
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import Float32, UInt8

from graycast.base.color import linear_share
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner, preset
from graycast.cell.domain.looks import light_of
from graycast.rig.pattern import CodeSpec
from graycast.world.parts import builtin_part
from graycast.world.parts.wood import wood_texture

OUT = Path(__file__).resolve().parents[1] / "configs" / "paper" / "other_world"
SEED = 2024
PITCH_M = 13.8e-6  # four of the paper's pixels in one
HEAPS: dict[str, Any] = {"inner_m": (0.40, 0.30, 0.15), "count": [20, 40], "distance_m": 0.81}
PACKAGES: dict[str, Any] = {"inner_m": (0.50, 0.38, 0.20), "count": [5, 10], "distance_m": 0.92}
PARTS = {
    "metal_workpiece_1": HEAPS,
    "metal_workpiece_2": HEAPS,
    "yellow_salt_cube": PACKAGES,
    "hygiene_spray": PACKAGES,
    "toothpaste": PACKAGES,
}


def random_scanner(rng: np.random.Generator) -> Scanner:
    paper = preset("paper", "small")
    lens = paper.rig.camera
    fx_px, f_number = lens.fx_px * rng.uniform(0.92, 1.08), rng.uniform(3.5, 6)
    camera = replace(
        lens,
        fx_px=fx_px,
        fy_px=fx_px,
        cx_px=lens.cx_px + rng.uniform(-4, 4),
        cy_px=lens.cy_px + rng.uniform(-4, 4),
        distortion=(
            rng.uniform(-0.08, -0.02), rng.uniform(0, 0.03), *rng.uniform(-5e-4, 5e-4, 2), 0.0,
        ),
        aperture_m=PITCH_M * fx_px / f_number,
        natural_vignetting=True,
    )  # fmt: skip
    fx_px = rng.uniform(1350, 1500)
    projector = replace(
        paper.rig.projector,
        width_px=1280,
        height_px=800,
        fx_px=fx_px,
        fy_px=fx_px,
        cx_px=639.5,
        cy_px=399.5,
        distortion=(rng.uniform(-0.03, 0.03), 0.0, 0.0, 0.0, 0.0),
        aperture_m=rng.uniform(3e-3, 6e-3),
        natural_vignetting=True,
    )
    baseline_m, cross_m = rng.uniform(0.30, 0.40), rng.uniform(0.85, 1.0)
    toe_in_rad = np.arctan2(baseline_m / 2, cross_m)
    roll = axis_rotation("z", np.radians(rng.uniform(-0.5, 0.5)))
    T_rig_cam = rigid(axis_rotation("y", toe_in_rad), np.array([-baseline_m / 2, 0.0, 0.0]))
    T_rig_proj = rigid(
        axis_rotation("y", -toe_in_rad) @ roll,
        np.array([baseline_m / 2, rng.uniform(-5e-3, 5e-3), 0.0]),
    )
    rig = replace(
        paper.rig,
        name="other-world",
        camera=replace(camera, focus_m=cross_m),
        projector=replace(projector, focus_m=cross_m),
        T_cam_proj=inverse(T_rig_cam) @ T_rig_proj,
        band_weights=(1.0, 0.0, 0.0),
        picture_level=0.0,
        contrast_ratio=rng.uniform(500, 1500),
    )
    sensor = replace(
        paper.sensor,
        wavelength_m=640e-9,
        pixel_pitch_m=PITCH_M,
        f_number=f_number,
        read_noise_e=np.exp(rng.uniform(np.log(5), np.log(9))),
        gain_dn_per_e=rng.uniform(0.15, 0.3),
        prnu=rng.uniform(0.005, 0.015),
        dsnu_e=rng.uniform(1, 4),
        fpn_seed=int(rng.integers(1000)),
    )
    return replace(
        paper,
        rig=rig,
        code=CodeSpec(codec="gray_phase", axes=("column",), period_px=40.0, steps=3),
        exposure=replace(paper.exposure, target=rng.uniform(0.6, 0.75)),
        sensor=sensor,
    )


def random_room(rng: np.random.Generator) -> Float32[np.ndarray, "64 128 3"]:
    """Return a room as a latitude-longitude picture (linear RGB); row 0 is the zenith."""
    room = np.empty((64, 128, 3), np.float32)
    room[:32] = rng.uniform(0.3, 0.6) * rng.uniform(0.9, 1.1, 3)  # ceiling and upper walls
    room[32:] = rng.uniform(0.1, 0.3) * rng.uniform(0.8, 1.2, 3)  # floor and furniture
    left = int(rng.integers(0, 100))
    room[16:30, left : left + int(rng.integers(10, 24))] = 4 * np.array(light_of(6500))  # window
    for _ in range(2):
        row, column = int(rng.integers(3, 12)), int(rng.integers(0, 110))
        room[row : row + 2, column : column + 12] = 12 * np.array(light_of(4000))
    return cv2.GaussianBlur(room, (0, 0), 0.8)


def random_lamp(rng: np.random.Generator) -> dict[str, Any]:
    distance_m, size_m = rng.uniform(1.2, 2.0), rng.uniform(0.15, 0.5)
    up, around = np.radians(rng.uniform(40, 75)), np.radians(rng.uniform(-180, 180))
    way = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    level = rng.uniform(0.05, 0.3) * (distance_m / size_m) ** 2
    radiance = level * np.array(light_of(rng.uniform(3000, 6000)))
    return {
        "center_m": np.round(distance_m * way, 3).tolist(),
        "size_m": round(size_m, 3),
        "radiance": np.round(radiance, 2).tolist(),
    }


def random_print(
    texture: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """Return the texture with other inks (exponent and gain of each band) and paper grain."""
    share = (texture / 255.0) ** rng.uniform(0.85, 1.2, 3) * rng.uniform(0.8, 1.0, 3)
    grain = cv2.GaussianBlur(rng.standard_normal(texture.shape[:2]), (0, 0), 1.5)
    share *= 1 + 0.02 * (grain / grain.std())[..., None]
    return np.round(255 * np.clip(share, 0, 1)).astype(np.uint8)


def random_material(name: str, rng: np.random.Generator) -> dict[str, Any]:
    own = builtin_part(name).material
    roughness = own.roughness + rng.uniform(-0.1, 0.1)
    if own.texture is not None:
        write_picture(f"{name}.jpg", random_print(own.texture, rng))
        return {"texture": f"{name}.jpg", "roughness": round(float(roughness), 3)}
    color = np.array(own.base_color) * np.exp(rng.uniform(np.log(0.7), np.log(1.5)))
    return {
        "base_color": np.round(color, 3).tolist(),
        "metallic": 1.0,
        "roughness": round(float(rng.uniform(0.35, 0.6)), 3),
    }


def write_picture(name: str, rgb: UInt8[np.ndarray, "h w 3"]) -> None:
    ok = cv2.imwrite(str(OUT / name), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert ok, name


def random_cell(name: str, rng: np.random.Generator) -> dict[str, Any]:
    heap = PARTS[name]
    azimuth_deg = rng.uniform(10, 30) * rng.choice([-1, 1])
    grey = float(linear_share(np.array(rng.uniform(0.15, 0.5))))
    return {
        "parts": [
            {
                "builtin": name,
                "scale": round(rng.uniform(0.995, 1.005), 4),
                "material": random_material(name, rng),
            }
        ],
        "count": heap["count"],
        "scenes": 15,
        "seed": int(rng.integers(1_000_000)),
        "rig": "rig.yaml",
        "bin": {
            "inner_m": np.round(heap["inner_m"] * rng.uniform(0.97, 1.03, 3), 4).tolist(),
            "material": {
                "texture": "wood.jpg",
                "roughness": round(rng.uniform(0.4, 0.8), 3),
            },
        },
        "table": {"base_color": [round(grey, 3)] * 3, "roughness": 0.8},
        "view": {
            "distance_m": round(heap["distance_m"] * rng.uniform(1.0, 1.08), 3),
            "tilt_deg": round(rng.uniform(3, 8), 2),
            "azimuth_deg": round(float(azimuth_deg), 2),
        },
        "light": {
            "environment": {"map": "room.hdr", "radiance": [round(rng.uniform(0.1, 0.3), 3)] * 3},
            "lamps": [random_lamp(rng) for _ in range(int(rng.integers(1, 3)))],
        },
        "domain": {"kind": "adapted"},
        "render": {
            "backend": "cycles",
            "samples": 12,
            "cycles": {"denoise": "none", "patterns_per_render": 3},
        },
    }


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    save_scanner(random_scanner(rng), OUT / "rig.yaml")
    assert cv2.imwrite(str(OUT / "room.hdr"), random_room(rng)[..., ::-1])
    tint, level = rng.uniform(0.85, 1.1, 3), rng.uniform(0.6, 1.0)
    wood = np.clip(wood_texture()[::-1, ::2].transpose(1, 0, 2) * tint * level, 0, 255)
    write_picture("wood.jpg", cv2.resize(wood.astype(np.uint8), (512, 512)))
    for name in PARTS:
        text = yaml.safe_dump(random_cell(name, rng), sort_keys=False, default_flow_style=None)
        head = "# Drawn by studies/draw_other_world.py, which says from what; not to be edited.\n"
        (OUT / f"{name}.yaml").write_text(head + text, encoding="utf-8")


if __name__ == "__main__":
    main()
