"""Measurements of this repository's own code: no part of the package `graycast`."""
