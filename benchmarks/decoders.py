"""Shared parts (temporary)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any
import numpy as np
from graycast.camera.decode import DecodeSpec, FilterSpec
from graycast.camera.scanner import Scanner, take
from .materials import _keys, _patterns


def bare(scanner: Scanner) -> Scanner:
    decode = DecodeSpec(
        min_contrast=0.002, min_sigmas=0.0, doubt=0.0, min_visibility=0.0, max_epipolar_px=0.0
    )
    return replace(scanner, decode=decode, filters=FilterSpec())


def shared_patterns(scanners: Sequence[Scanner]):
    return _patterns({str(k): s for k, s in enumerate(scanners)})


def pictures_of(scanner, radiance, keys, *, seed):
    own = [keys.index(key) for key in _keys(scanner)]
    light = replace(radiance, pattern=radiance.pattern[own])
    return take(scanner, light, seed=seed), light
