"""mmdetection's configurations of our networks, and its weights under our names."""

# These are the published values, for the picture sizes of the publications.
ANCHORS_416_PX = (
    ((116, 90), (156, 198), (373, 326)),
    ((30, 61), (62, 45), (59, 119)),
    ((10, 13), (16, 30), (33, 23)),
)
RANGES_597_PX = ((1, 56), (28, 112), (56, 224), (112, 448), (224, 896))
YOLOV3 = {
    "darknet53": {
        "backbone": {"type": "Darknet", "depth": 53, "out_indices": (3, 4, 5)},
        "inside": [1024, 512, 256],
        "neck": [512, 256, 128],
        "head": [1024, 512, 256],
    },
    # Published with a leaky activation; torchvision's weights need ReLU6, mmdetection's default.
    "mobilenet-v2": {
        "backbone": {"type": "MobileNetV2", "out_indices": (2, 4, 6)},
        "inside": [320, 96, 32],
        "neck": [96, 96, 96],
        "head": [96, 96, 96],
    },
}
SOLOV2 = {
    "resnet18": {"depth": 18, "inside": [64, 128, 256, 512], "tower": (256, 2), "kernel": 128},
    "resnet50": {"depth": 50, "inside": [256, 512, 1024, 2048], "tower": (512, 4), "kernel": 256},
}
PIXELS = {"type": "DetDataPreprocessor"}


def yolov3(backbone, *, classes, side, least, most):
    parts = YOLOV3[backbone]
    anchors = [[(w * side / 416, h * side / 416) for w, h in level] for level in ANCHORS_416_PX]
    cross_entropy = {"type": "CrossEntropyLoss", "use_sigmoid": True, "reduction": "sum"}
    return {
        "type": "YOLOV3",
        "data_preprocessor": PIXELS,
        "backbone": parts["backbone"],
        "neck": {
            "type": "YOLOV3Neck",
            "num_scales": 3,
            "in_channels": parts["inside"],
            "out_channels": parts["neck"],
        },
        "bbox_head": {
            "type": "YOLOV3Head",
            "num_classes": classes,
            "in_channels": parts["neck"],
            "out_channels": parts["head"],
            "anchor_generator": {
                "type": "YOLOAnchorGenerator",
                "base_sizes": anchors,
                "strides": [32, 16, 8],
            },
            "loss_cls": {**cross_entropy, "loss_weight": 1.0},
            "loss_conf": {**cross_entropy, "loss_weight": 1.0},
            "loss_xy": {**cross_entropy, "loss_weight": 2.0},
            "loss_wh": {"type": "MSELoss", "loss_weight": 2.0, "reduction": "sum"},
        },
        "train_cfg": {
            "assigner": {
                "type": "GridAssigner",
                "pos_iou_thr": 0.5,
                "neg_iou_thr": 0.5,
                "min_pos_iou": 0,
            }
        },
        "test_cfg": {
            "nms_pre": 100_000,
            "min_bbox_size": 0,
            "score_thr": 0,
            "conf_thr": 0,
            "nms": {"type": "nms", "iou_threshold": 0.45},
            "max_per_img": most,
        },
    }


def solov2(backbone, *, classes, side, least, most):
    parts = SOLOV2[backbone]
    width, depth = parts["tower"]
    scale = side / (56 * 32 / 3)
    return {
        "type": "SOLOv2",
        "data_preprocessor": PIXELS,
        "backbone": {
            "type": "ResNet",
            "depth": parts["depth"],
            "num_stages": 4,
            "out_indices": (0, 1, 2, 3),
            "style": "pytorch",
        },
        "neck": {
            "type": "FPN",
            "in_channels": parts["inside"],
            "out_channels": 256,
            "start_level": 0,
            "num_outs": 5,
        },
        "mask_head": {
            "type": "SOLOV2Head",
            "num_classes": classes,
            "in_channels": 256,
            "feat_channels": width,
            "stacked_convs": depth,
            "strides": [8, 8, 16, 32, 32],
            "scale_ranges": [(max(a * scale, 1.0), b * scale) for a, b in RANGES_597_PX],
            "pos_scale": 0.2,
            "num_grids": [40, 36, 24, 16, 12],
            "cls_down_index": 0,
            "mask_feature_head": {
                "feat_channels": 128,
                "start_level": 0,
                "end_level": 3,
                "out_channels": parts["kernel"],
                "mask_stride": 4,
                "norm_cfg": {"type": "GN", "num_groups": 32, "requires_grad": True},
            },
            "loss_mask": {"type": "DiceLoss", "use_sigmoid": True, "loss_weight": 3.0},
            "loss_cls": {
                "type": "FocalLoss",
                "use_sigmoid": True,
                "gamma": 2.0,
                "alpha": 0.25,
                "loss_weight": 1.0,
            },
        },
        "test_cfg": {
            "nms_pre": 500,
            "score_thr": least,
            "mask_thr": 0.5,
            "filter_thr": least,
            "kernel": "gaussian",
            "sigma": 2.0,
            "max_per_img": most,
        },
    }


# Our prefixes, and mmdetection's prefixes of the same parts in the same order.
PARTS = {
    "yolov3": {
        "body.": ["backbone."],
        "neck.blocks.": ["neck.detect"],
        "neck.bridges.": ["neck.conv"],
        **{f"ends.{i}.first.": [f"bbox_head.convs_bridge.{i}."] for i in range(3)},
        **{f"ends.{i}.last.": [f"bbox_head.convs_pred.{i}."] for i in range(3)},
    },
    "solov2": {
        "body.": ["backbone."],
        "pyramid.inner_blocks.": ["neck.lateral_convs."],
        "pyramid.layer_blocks.": ["neck.fpn_convs."],
        "painter.": ["mask_head.mask_feature_head."],
        "kernels.": ["mask_head.kernel_convs.", "mask_head.conv_kernel."],
        "judges.": ["mask_head.cls_convs.", "mask_head.conv_cls."],
    },
}
# mmdetection keeps this end of the classifier but does not run it.
UNUSED = {"mobilenet-v2": "backbone.conv2."}


def under_our_names(model, backbone, state, ours):
    """Return mmdetection's weights under the names in `ours`, the state dict of our network."""
    unused = UNUSED.get(backbone, "nothing")
    left = {name: value for name, value in state.items() if not name.startswith(unused)}
    renamed = {}
    for begin, theirs in PARTS[model].items():
        names = [name for name in ours if name.startswith(begin)]
        values = [left.pop(n) for part in theirs for n in list(left) if n.startswith(part)]
        renamed |= dict(zip(names, values, strict=True))
    assert not left
    return renamed
