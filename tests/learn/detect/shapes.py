"""Pictures of discs and boxes with exact labels, and their average precision by pycocotools."""

import contextlib
import io

import numpy as np
import torch
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from graycast.learn.detect.network import Target

CLASSES = 2  # discs and boxes


def shape_pictures(count, *, size_px, channels, seed, parts=5):
    """Return images of bright parts on dark noise, which may overlap, and the targets."""
    draw = torch.Generator().manual_seed(seed)
    images, targets = [], []
    for _ in range(count):
        image = 0.1 * torch.rand(channels, *size_px, generator=draw)
        masks = torch.zeros(0, *size_px, dtype=torch.bool)
        labels = torch.randint(CLASSES, (parts,), generator=draw)
        for label in labels.tolist():
            mask = _part(label, size_px, torch.rand(3, generator=draw).tolist())
            image[:, mask] = (0.4 + 0.6 * torch.rand(channels, generator=draw))[:, None]
            masks = torch.cat([masks & ~mask, mask[None]])
        visible = masks.flatten(1).sum(dim=1) > 60
        images.append(image)
        targets.append(target_of(masks[visible], labels[visible]))
    return torch.stack(images), targets


def _part(label, size_px, chance):
    height, width = size_px
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    half = 10 + 14 * chance[0]
    x, y = 20 + (width - 40) * chance[1], 20 + (height - 40) * chance[2]
    if label == 0:
        return (column - x) ** 2 + (row - y) ** 2 < half**2
    return ((column - x).abs() < half) & ((row - y).abs() < 0.8 * half)


def target_of(mask, label, *, ignored=()):
    """Return a target with the boxes that enclose the masks; `ignored` lists indices."""
    box = torch.zeros(len(mask), 4)
    for index, one in enumerate(mask):
        row, column = one.nonzero().T
        edges = (column.min(), row.min(), column.max() + 1, row.max() + 1)
        box[index] = torch.tensor([int(edge) for edge in edges])
    hidden = torch.zeros(len(mask), dtype=torch.bool)
    hidden[list(ignored)] = True
    return Target(box=box, label=label, mask=mask, ignored=hidden)


def ap50(targets, answers, kind):
    """Return COCO's average precision at an overlap of 0.5; `kind` is `bbox` or `segm`."""
    truth, results = COCO(), []
    truth.dataset = {
        "images": [
            {"id": i, "height": t.mask.shape[1], "width": t.mask.shape[2]}
            for i, t in enumerate(targets)
        ],
        "annotations": [],
        "categories": [{"id": i} for i in range(CLASSES)],
        "info": {},
    }
    for image, (target, answer) in enumerate(zip(targets, answers, strict=True)):
        for index, entry in enumerate(_entries(image, target.box, target.label, target.mask)):
            number = len(truth.dataset["annotations"]) + 1
            area = float(target.mask[index].sum())
            truth.dataset["annotations"].append({**entry, "id": number, "area": area, "iscrowd": 0})
        mask = None if answer.mask is None else answer.mask > 127
        entries = _entries(image, answer.box, answer.label, mask)
        scores = answer.score.tolist()
        results += [{**e, "score": s} for e, s in zip(entries, scores, strict=True)]
    if not results:
        return 0.0
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        judge = COCOeval(truth, truth.loadRes(results), kind)
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return float(judge.stats[1])


def _entries(image, box, label, mask):
    out = []
    for index, (x0, y0, x1, y1) in enumerate(box.tolist()):
        entry = {"image_id": image, "category_id": int(label[index])}
        entry["bbox"] = [x0, y0, x1 - x0, y1 - y0]
        if mask is not None:
            pixels = np.asfortranarray(mask[index].numpy().astype(np.uint8))
            entry["segmentation"] = coco_mask.encode(pixels)
        out.append(entry)
    return out
