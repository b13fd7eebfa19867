"""What a real scanner brings. Each folder stands on the files above it and knows no other folder.

depth_file   depth maps, pictures and camera matrices from files of any scanner
organised    organised point clouds
pictures     colour, brightness and depth of one picture, paired by the names of their files

calibrate    a rig from pictures of a board
fit_bin      pose, colours and light of a real, empty bin
import_real  real pictures with labels, as a dataset
realism      what real depth has and perfect depth lacks, in figures
"""
