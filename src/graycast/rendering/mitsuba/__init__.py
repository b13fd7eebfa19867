"""Mitsuba 3 as a back end: one pass of light paths for all patterns.

These modules load Mitsuba, so they are imported after `open_device` has set its variant. Each
module imports only from the modules above it:

    patterns   patterns in few bits, and sums over them
    lens       lenses in Dr.Jit
    sight      intersections of rays with the scene, through glass
    projector  the projector as a light
    scene      a scene in Mitsuba: materials, meshes, lights
    lobe       the light that a material reflects between two directions
    stage      the data that all light paths through a scene share
    caustics   light paths from the projector over shiny surfaces: caustics
    truth      depth, normals and silhouettes at pixel centres
    paths      light paths from the camera, for all patterns at once
    renderer   the renderer of one pass for all patterns
"""
