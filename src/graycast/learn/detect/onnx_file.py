"""Export of a detector as an ONNX file, which is compared with torch before it is written."""

import io
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from ...base.errors import GraycastError
from ...base.folder import write_whole
from .detector import Detector

NAMES = ("box", "label", "score", "mask")
_OPSET = 17
_MOST_OFF_PX, _MOST_OFF_SCORE = 0.05, 1e-3


class _OnePicture(nn.Module):
    """A module that returns a network's detections in one picture as plain tensors."""

    def __init__(self, network: nn.Module, most: int, least_score: float) -> None:
        super().__init__()
        self.network, self.most, self.least_score = network, most, least_score

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        output = self.network.find(image, most=self.most, least_score=self.least_score)[0]
        tensors = (output.box, output.label, output.score)
        return tensors if output.mask is None else (*tensors, output.mask)


def write_onnx(
    detector: Detector, file: Path, *, most: int = 300, least_score: float = 0.05
) -> None:
    """Write an ONNX file whose input is `image`, an encoded picture (1, channels, h, w).

    Outputs are `box` (n, 4) as x0, y0, x1, y1 and `mask` (n, h, w), 0 to 255, in pixels of the
    input, `label` (n) and `score` (n). The encoding and the classes are in the file's metadata
    under `graycast`, as JSON.

    Raises:
        GraycastError: onnx is not installed, the network cannot be written as ONNX, or onnxruntime
            and torch give different detections in a picture of noise.
    """
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise GraycastError(
            "ONNX files need onnx and onnxruntime: run pip install 'graycast[detect]'"
        ) from error
    cpu = torch.device("cpu")
    network = detector.about.open_network()
    network.load_state_dict({k: v.to(cpu) for k, v in detector.network.state_dict().items()})
    model = _OnePicture(network, most, least_score).eval()
    traced, *others = (_noise(detector, seed) for seed in range(3))
    names = list(NAMES if network.finds_masks else NAMES[:3])
    traced_model = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # The check below covers the tracer's warnings.
            torch.onnx.export(
                model,
                (traced,),
                traced_model,
                dynamo=False,
                opset_version=_OPSET,
                input_names=["image"],
                output_names=names,
                dynamic_axes={name: {0: "n"} for name in names},
            )
        onnx_model = onnx.load_model_from_string(traced_model.getvalue())
        entry = onnx_model.metadata_props.add()
        entry.key, entry.value = "graycast", json.dumps(detector.about.as_dict())
        content = onnx_model.SerializeToString()
    except (torch.onnx.OnnxExporterError, RuntimeError, TypeError) as error:
        why = " ".join(str(error).split())[:120]
        raise GraycastError(f"{detector.about.model} cannot be written as ONNX ({why})") from error
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # no warnings about sizes that vary between pictures
    session = onnxruntime.InferenceSession(content, options)
    for image in others:  # Other pictures reveal a value that tracing froze.
        _compare(session, model, image)
    write_whole(file, content)


def _noise(detector: Detector, seed: int) -> Tensor:
    encoding = detector.about.encoding
    shape = (1, encoding.channels, *encoding.size_px)
    return torch.from_numpy(np.random.default_rng(seed).normal(size=shape).astype(np.float32))


def _compare(session, model: Callable[[Tensor], tuple[Tensor, ...]], image: Tensor) -> None:
    """Check that onnxruntime and torch give equal detections, except near the lowest score."""
    with torch.no_grad():
        box, _, score = (each.numpy() for each in model(image)[:3])
    try:
        onnx_box, _, onnx_score = session.run(None, {"image": image.numpy()})[:3]
    except Exception as error:  # onnxruntime has no error class for this.
        raise GraycastError(
            f"onnxruntime cannot run the file: {' '.join(str(error).split())}"
        ) from error
    if len(box) == len(onnx_box):
        off_score = np.abs(np.sort(score) - np.sort(onnx_score)).max(initial=0)
        sure = score > score.min(initial=1) + _MOST_OFF_SCORE
        apart = np.abs(box[sure][:, None] - onnx_box[None]).max(axis=2, initial=0)
        off_px = apart.min(axis=1, initial=np.inf if len(onnx_box) else 0).max(initial=0)
        if off_score <= _MOST_OFF_SCORE and off_px <= _MOST_OFF_PX:
            return
    raise GraycastError(
        f"onnxruntime finds other detections than torch ({len(onnx_box)} and {len(box)} in a "
        "picture of noise): the file is not written; try another release of torch or onnxruntime"
    )
