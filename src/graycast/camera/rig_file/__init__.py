"""Read and write scanners as Graycast's YAML files, and read OpenCV stereo calibrations."""

from .opencv import import_opencv, missing_distortions
from .own import load_scanner, named_scanner, save_scanner, scanner_text
from .scanner_sections import (
    ScannerSections,
    SettingRange,
    own_device,
    setting_ranges,
    with_sections,
)

__all__ = [
    "ScannerSections",
    "SettingRange",
    "import_opencv",
    "load_scanner",
    "missing_distortions",
    "named_scanner",
    "own_device",
    "save_scanner",
    "scanner_text",
    "setting_ranges",
    "with_sections",
]
