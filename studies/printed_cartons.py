"""Random printed cartons and blister cards: flat, mostly white, with text and pictures.

Scanners measure white paper with little noise and dark print with more, so scans of a heap without
cartons have another distribution of noise. A carton is a box in metres with a texture of six faces,
and does not copy a real object.
"""

import cv2
import numpy as np
import trimesh
from PIL import Image

FACE_PX = 384  # the longer edge of a face in the texture
_WHITE_SHARE = 0.75
# For each face: the axis and sign of its normal, and the axes of its picture.
_FACES = [(0, 1, 1, 2), (0, -1, 2, 1), (1, 1, 2, 0), (1, -1, 0, 2), (2, 1, 0, 1), (2, -1, 1, 0)]


def printed_carton(seed: int) -> trimesh.Trimesh:
    """Return the carton of a seed: 6 to 20 cm wide and long, and 8 mm (a card) to 6 cm thick."""
    rng = np.random.default_rng([21, seed])
    width_m, length_m = sorted(rng.uniform(0.06, 0.20, 2))
    size_m = np.array([width_m, length_m, rng.choice([0.008, 0.02, 0.035, 0.06])])
    paper = rng.uniform(205, 245) if rng.random() < _WHITE_SHARE else rng.uniform(60, 240, 3)
    base = np.broadcast_to(np.asarray(paper), 3).astype(np.uint8)
    sheet = np.zeros((2 * FACE_PX, 3 * FACE_PX, 3), dtype=np.uint8)
    vertices_m, faces, uv = [], [], []
    for k, (normal, side, right, up) in enumerate(_FACES):
        row, column = divmod(k, 3)
        wide_px, high_px = (FACE_PX * size_m[[right, up]] / size_m[[right, up]].max()).astype(int)
        picture = _print(rng, base, max(wide_px, 8), max(high_px, 8), size_m[right])
        cell = sheet[row * FACE_PX : (row + 1) * FACE_PX, column * FACE_PX : (column + 1) * FACE_PX]
        cell[:] = cv2.resize(picture, (FACE_PX, FACE_PX), interpolation=cv2.INTER_AREA)
        for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = np.empty(3)
            corner[normal], corner[right], corner[up] = side / 2, x - 0.5, y - 0.5
            vertices_m.append(corner * size_m)
            uv.append([(column + x) / 3, 1 - (row + 1 - y) / 2])
        faces += [[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(sheet),
        roughnessFactor=float(rng.uniform(0.3, 0.8)),
        metallicFactor=0.0,
    )
    visual = trimesh.visual.TextureVisuals(uv=np.array(uv), material=material)
    return trimesh.Trimesh(np.array(vertices_m), np.array(faces), visual=visual, process=False)


def _print(
    rng: np.random.Generator, base: np.ndarray, wide_px: int, high_px: int, wide_m: float
) -> np.ndarray:
    """Draw one face in its true proportions: fields of colour, lines of text, a bar code."""
    picture = np.empty((high_px, wide_px, 3), dtype=np.uint8)
    picture[:] = base
    px_per_m = wide_px / wide_m
    for _ in range(rng.integers(0, 3)):
        color = rng.uniform(10, 220, 3).tolist()
        middle = (rng.uniform(0.2, 0.8, 2) * (wide_px, high_px)).astype(int).tolist()
        half = (rng.uniform(0.08, 0.3, 2) * (wide_px, high_px)).astype(int).tolist()
        cv2.ellipse(picture, middle, half, 0, 0, 360, color, -1, cv2.LINE_AA)
    y_px = 0.0
    while True:
        height_px = rng.choice([0.003, 0.005, 0.012], p=[0.6, 0.3, 0.1]) * px_per_m
        y_px += 2 * height_px
        if y_px > high_px:
            break
        if rng.random() < 0.6:
            text = "".join(rng.choice(list("abcdefghikmnoprstuw ABEHKR058"), 40))
            at = (int(rng.uniform(0, 0.4) * wide_px), int(y_px))
            thick_px = max(int(height_px / 6), 1)
            ink = [float(rng.uniform(10, 120))] * 3
            font = cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(picture, text, at, font, height_px / 22, ink, thick_px, cv2.LINE_AA)
    if rng.random() < 0.5:
        bars = np.where(rng.random(30) < 0.5, 20, 240).astype(np.uint8)
        tall, wide = int(0.015 * px_per_m), int(0.03 * px_per_m)
        if 0 < tall < high_px and 0 < wide < wide_px:
            y, x = int(rng.integers(high_px - tall)), int(rng.integers(wide_px - wide))
            code = cv2.resize(bars[None], (wide, tall), interpolation=cv2.INTER_NEAREST)
            picture[y : y + tall, x : x + wide] = code[..., None]
    return picture
