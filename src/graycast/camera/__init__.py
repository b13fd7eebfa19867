"""From the light on the sensor to depth, for simulated pictures and for real ones.

Each module imports only from the modules above it:

    light       from rendered radiance to the light on the sensor
    sensor      noise, saturation, quantisation: Radiance -> Capture
    exposure    exposure times: fixed, or chosen from the light
    speckle     laser speckle, its patches, and its effect on decoded positions
    decode      from pictures to projector positions and depth: Capture -> DepthMap; the reason why
                a pixel has no depth (`maps.Reason`); ambiguous periods (`phases`, `settling`,
                `positions`)
    line_noise  projector lines that are brighter or darker in each picture
    sigma       standard deviation of depth, with a list of all its terms
    faults      errors of depth that grow with the slope of a surface and are the same in each scan
    scanner     a rig with its code, sensor, exposure, decoder, filters and faults
    picture     the colour picture and the grey picture of the measuring camera
    rig_file    scanners in files, and imported calibrations
    stack       pictures of real scanners: description, decoding, results
    crop        a window of a depth map, as points with normals
"""
