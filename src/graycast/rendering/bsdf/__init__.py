"""Materials of Mitsuba: bidirectional scattering distribution functions of surfaces.

Each module imports only from the modules above it:

    mottle            reflectance that varies from place to place
    ggx               the distribution of microfacets of all rough materials
    dielectric        clear glass and plastic
    coated_diffuse    plastic and paint: a clear coat over a diffuse base
    rough_conductor   metal, also brushed or turned
    filmed_conductor  metal under oil or lacquer
"""
