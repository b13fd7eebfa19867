"""A structured-light scan of third-party scenes: perfect depth in, scanner depth out.

source            the content of a dataset in any layout, and facts that only a user can state
source_files      depth, colours, cameras and poses from third-party files, with checks
model_files       third-party models as parts, with their look
bop_source        datasets in BOP's form
sileane_source    the Siléane and the Fraunhofer IPA dataset
depth_source      folders with only perfect depth
open_source       choice of the reader by the layout of a folder
staging           an image as a scene: objects, and everything else as a solid behind them
rescan_folder     the folder of the result: links to the original, and the scanner's files
rescanning        all images, by workers
"""
