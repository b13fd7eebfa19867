"""Compute losses and detections with mmdetection, in an interpreter that has this package.

`python mmdet_alone.py CASE OUT`: CASE holds a configuration, a batch and its labels; OUT gets
random weights under mmdetection's names, raw maps, each term of the loss, and what is detected.
"""

import sys
import types
import warnings

import mmcv
import torch
import torchvision

warnings.filterwarnings("ignore")


def stand_in_for_compiled_parts():
    """Replace the compiled operator that mmcv-lite lacks and these models need, and change the
    release number of mmcv, for which alone mmdetection would refuse it."""
    compiled = types.ModuleType("mmcv._ext")

    def nms(boxes, scores, iou_threshold, offset):
        assert offset == 0
        return torchvision.ops.nms(boxes, scores, iou_threshold)

    compiled.nms = nms
    compiled.__getattr__ = lambda name: None
    compiled.__spec__ = None
    sys.modules["mmcv._ext"] = compiled
    mmcv.__version__ = "2.1.0"


def with_lively_weights(model, image):
    """Set weights whose scores vary over the picture without saturation, unlike initial ones."""
    for module in model.modules():
        if isinstance(module, torch.nn.Conv2d):
            torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                torch.nn.init.uniform_(module.bias, -0.5, 0.5)
        elif isinstance(module, torch.nn.BatchNorm2d | torch.nn.GroupNorm):
            torch.nn.init.uniform_(module.weight, 0.5, 1.0)
            torch.nn.init.uniform_(module.bias, -0.2, 0.2)
            if isinstance(module, torch.nn.BatchNorm2d):
                torch.nn.init.uniform_(module.running_mean, -0.2, 0.2)
                torch.nn.init.uniform_(module.running_var, 0.5, 1.5)
    spread = {}
    last = [m for n, m in model.named_modules() if n.endswith("conv_cls") or "convs_pred." in n]
    hooks = [m.register_forward_hook(lambda m, _, y: spread.update({m: y.std()})) for m in last]
    with torch.no_grad():
        model._forward(image)
        for module, hook in zip(last, hooks, strict=True):
            module.weight /= spread[module]
            hook.remove()
    for name, module in model.named_modules():
        if name.endswith("conv_cls"):  # fewer cells with a score than Matrix NMS takes
            module.weight.data *= 3
            module.bias.data.fill_(-10)


def main(case_file, out_file):
    torch.set_num_threads(1)
    stand_in_for_compiled_parts()
    from mmdet.registry import MODELS
    from mmdet.structures import DetDataSample
    from mmdet.structures.mask import BitmapMasks
    from mmdet.utils import register_all_modules
    from mmengine.config import ConfigDict
    from mmengine.structures import InstanceData

    register_all_modules()
    case = torch.load(case_file)
    torch.manual_seed(case["seed"])
    model = MODELS.build(ConfigDict(case["config"]))
    model.eval()
    image = case["image"]
    with_lively_weights(model, image)
    height, width = image.shape[-2:]
    samples = []
    for label in case["labels"]:
        mask = BitmapMasks(label["mask"].numpy().astype("uint8"), height, width)
        shape = {k: (height, width) for k in ("img_shape", "ori_shape", "batch_input_shape")}
        samples.append(
            DetDataSample(
                metainfo={**shape, "scale_factor": (1.0, 1.0)},
                gt_instances=InstanceData(bboxes=label["box"], labels=label["label"], masks=mask),
            )
        )
    with torch.no_grad():
        raw = model._forward(image)
        losses = model.loss(image, samples)
        answers = [s.pred_instances for s in model.predict(image, samples, rescale=False)]
    names = ("scores", "labels", "bboxes", "masks")
    torch.save(
        {
            "state": model.state_dict(),
            "raw": raw,
            "losses": {
                k: torch.as_tensor(v) if torch.is_tensor(v) else sum(v) for k, v in losses.items()
            },
            "found": [{n: a[n] for n in names if n in a} for a in answers],
        },
        out_file,
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
