"""Measurements of the code of this repository, which are not part of the package `graycast`."""
