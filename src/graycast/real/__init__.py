"""Data of real scanners, and third-party datasets.

Each module imports only from modules above it:

    calibrate      a rig from pictures of a board
    depth_file     depth maps, pictures and camera matrices from files of any scanner
    depth_sense    checks of depth: unit, filled holes, z or ray lengths
    depth_solid    a depth map as a solid for a scene: surface, edges, sides
    fitted_config  a configuration in which some keys are replaced by fitted values
    picture_pairs  colour, brightness and depth of one picture, paired by file names
    realism        statistics of real depth that perfect depth lacks
    fit_bin        pose, colours and light of a real bin
    import_real    real pictures with labels, as a dataset
    material       base colour, roughness and kind of a surface from one scan
    rescan         scanner depth for third-party datasets with perfect depth
    twin           a scanner whose simulated scans have the statistics of real ones
"""
