"""The description of a scanner: its optics, its codes, and the pair of camera and projector.

Each module imports only from the modules above it:

    lens_inverse     the inverse of lens distortion, compiled
    optics           camera and projector: distortion and its inverse, thin lens, vignetting
    meshdepth        the depth of a mesh at pixel centres, for checks
    former_names     names that scanners had in earlier versions
    pattern          the frames that a projector shows, and the codes made of them
    shelf            scanners by name, in files, with the source of each number
    pair             a camera and a projector with fixed relative pose
"""
