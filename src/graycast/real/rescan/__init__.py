"""Simulated structured-light scans of third-party datasets that have perfect depth.

source            the content of a dataset in any layout, and facts that only a user can state
source_files      readers of depth, colours, cameras and poses in third-party files, with checks
model_files       third-party models as parts, with their materials
bop_source        datasets in BOP's form
sileane_source    the Siléane and the Fraunhofer IPA datasets
depth_source      folders with only perfect depth
open_source       choice of the reader by the layout of a folder
staging           a scene from an image: objects, and a solid behind them for everything else
rescan_folder     the folder of the result: links to the original, and the scanner's files
rescanning        the scan of all images by worker processes
"""
