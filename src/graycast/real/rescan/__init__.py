"""A structured-light scan of scenes that others made: perfect depth in, scanner depth out.

source            what every layout gives, and what a user says where its files leave it open
source_files      depth, colours, cameras and poses of others, refused where they cannot be
model_files       models of others as parts, with their look
bop_source        datasets in BOP's form
sileane_source    the Siléane and the Fraunhofer IPA dataset
depth_source      folders of perfect depth alone
open_source       a source by the layout of its folder
staging           an image as a scene: objects, and all else as a solid behind them
rescan_folder     the folder of the result: links to what was there, and what the scanner adds
rescanning        all images, by workers
"""
