"""Open Image Denoise, called as its convenience function calls it, with and without a GPU."""

import subprocess
import sys
from unittest import TestCase

import numpy as np
import pyoidn
import pytest

from graycast.rendering.denoise import OpenImageDenoise, denoise, open_denoiser


def noisy_wall(h, w):
    """Return a wall that is brighter on the right, with noise of a tenth."""
    rng = np.random.default_rng(0)
    clean = np.repeat(np.tile(np.linspace(0.4, 0.6, w), (h, 1))[..., None], 3, axis=2)
    normal = np.broadcast_to([0.0, 0.0, -1.0], clean.shape)
    return clean, clean + rng.normal(0, 0.1, clean.shape), np.full(clean.shape, 0.5), normal


def test_denoising_reduces_noise_keeps_light_and_builds_one_network_per_size():
    by = open_denoiser("cpu")
    for h, w in ((48, 64), (48, 64), (64, 48)):
        clean, noisy, albedo, normal = noisy_wall(h, w)
        result = denoise(noisy, albedo, normal, by)
        assert (result - clean).std() < 0.03 < (noisy - clean).std()
        assert result.mean() == pytest.approx(clean.mean(), abs=0.01)
        inputs = [np.ascontiguousarray(x, dtype=np.float32) for x in (noisy, albedo, normal)]
        assert np.array_equal(result, pyoidn.denoise(*inputs, hdr=True))


def test_if_the_gpu_cannot_denoise_the_processor_denoises_and_a_line_is_logged(monkeypatch):
    monkeypatch.setattr(pyoidn.Device, "is_cuda_available", staticmethod(lambda: False))
    with TestCase().assertLogs() as logs:
        by = open_denoiser("cuda")
        open_denoiser("cpu")
    assert isinstance(by, OpenImageDenoise) and by.device == "cpu"
    (record,) = logs.records
    assert "denoised on the processor, because the GPU cannot" in record.getMessage()


@pytest.mark.slow
def test_the_denoiser_does_not_load_pytorch(tmp_path):
    """PyTorch costs 2 s and 500 MB in every worker; code that needs it can load it afterwards."""
    (tmp_path / "torch.py").write_text("name = 'stand-in'")
    program = """
import sys
from graycast.rendering.denoise import open_denoiser
open_denoiser("cpu")
print("torch" in sys.modules)
import torch
print(torch.name)
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "stand-in"]
