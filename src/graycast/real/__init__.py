"""Data of a real scanner, and datasets that others made.

Each folder imports only the files listed above it, except `twin`, which also imports `realism`.

depth_file   depth maps, pictures and camera matrices from files of any scanner
depth_sense  whether depth can be what it is given for
picture_pairs  colour, brightness and depth of one picture, paired by the names of their files
depth_solid  a depth map as a solid for a scene: surface, edges, sides
fitted_config  a configuration in which some keys are replaced by what was fitted

calibrate    a rig from pictures of a board
fit_bin      pose, colours and light of a real, empty bin
import_real  real pictures with labels, as a dataset
realism      what real depth has and perfect depth lacks, in figures
rescan       scanner depth for the perfect depth of datasets that others made
twin         a scanner whose simulated scans have the statistics of real ones
"""
