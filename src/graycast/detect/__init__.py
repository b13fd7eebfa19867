"""Detectors trained on datasets, and what they find in pictures; needs `graycast[detect]`."""
