"""Data of a real scanner, and datasets that others made.

Each imports only from those above it:

    calibrate      a rig from pictures of a board
    depth_file     depth maps, pictures and camera matrices from files of any scanner
    depth_sense    whether depth can be what it is given for
    depth_solid    a depth map as a solid for a scene: surface, edges, sides
    fitted_config  a configuration in which some keys are replaced by fitted values
    picture_pairs  colour, brightness and depth of one picture, paired by the names of their files
    realism        what real depth has and perfect depth lacks, in figures
    fit_bin        pose, colours and light of a real bin
    import_real    real pictures with labels, as a dataset
    material       base colour, roughness and kind of a surface from one scan
    rescan         scanner depth for the perfect depth of datasets that others made
    twin           a scanner whose simulated scans have the statistics of real ones
"""
