"""From the light on the sensor to depth, for simulated pictures and for real ones.

Each imports only from those above it:

    light       from rendered radiance to the light on the sensor
    sensor      noise, saturation, quantisation: Radiance -> Capture
    speckle     laser speckle, its patches, and its effect on decoded positions
    decode      from pictures to projector positions and depth: Capture -> DepthMap
    line_noise  uneven projector lines, and their effect on decoded positions
    faults      depth of points beside their pixels, for simulated scans
    scanner     a rig with its code, sensor, exposure, decoder, filters and faults
    picture     the colour picture and the grey picture of the measuring camera
    rig_file    scanners in files, and imported calibrations
    stack       pictures of real scanners: description, decoding, results
    crop        a window of a depth map, as points with normals
"""
