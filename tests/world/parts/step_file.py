"""A box as a STEP file (ISO 10303-21, AP214): surfaces and edges, with the unit of length."""

import numpy as np

_FACES = (  # corners of each face, counter-clockwise from outside, and its normal
    ((0, 2, 3, 1), (0, 0, -1)),
    ((4, 5, 7, 6), (0, 0, 1)),
    ((0, 1, 5, 4), (0, -1, 0)),
    ((2, 6, 7, 3), (0, 1, 0)),
    ((0, 4, 6, 2), (-1, 0, 0)),
    ((1, 3, 7, 5), (1, 0, 0)),
)


class _Lines(list):
    def add(self, text):
        self.append(f"#{len(self) + 1}={text};")
        return f"#{len(self)}"

    def triple(self, kind, numbers):
        return self.add(f"{kind}('',({','.join(f'{float(n)!r}' for n in numbers)}))")

    def placed(self, point, normal, along):
        axes = [self.triple("DIRECTION", axis) for axis in (normal, along)]
        return self.add(f"AXIS2_PLACEMENT_3D('',{point},{','.join(axes)})")


def step_box(length, width, height, prefix):
    """Return the text of the file; `prefix` is the SI prefix of the metre, such as .MILLI."""
    lines = _Lines()
    size = np.array([length, width, height])
    corner = [np.array([k & 1, k >> 1 & 1, k >> 2]) * size for k in range(8)]
    point = [lines.triple("CARTESIAN_POINT", at) for at in corner]
    vertex = [lines.add(f"VERTEX_POINT('',{p})") for p in point]
    edges = {}

    def edge(a, b):
        if (b, a) in edges:
            return f"{edges[b, a]},.F."
        way = lines.triple("DIRECTION", (corner[b] - corner[a]) / np.ptp(corner[b] - corner[a]))
        vector = lines.add(f"VECTOR('',{way},1.)")
        line = lines.add(f"LINE('',{point[a]},{vector})")
        edges[a, b] = lines.add(f"EDGE_CURVE('',{vertex[a]},{vertex[b]},{line},.T.)")
        return f"{edges[a, b]},.T."

    faces = []
    for loop, normal in _FACES:
        sides = zip(loop, loop[1:] + loop[:1], strict=True)
        way = ",".join([lines.add(f"ORIENTED_EDGE('',*,*,{edge(a, b)})") for a, b in sides])
        bound = lines.add(f"EDGE_LOOP('',({way}))")
        bound = lines.add(f"FACE_OUTER_BOUND('',{bound},.T.)")
        plane = lines.placed(point[loop[0]], normal, np.roll(normal, 1))
        plane = lines.add(f"PLANE('',{plane})")
        faces.append(lines.add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = lines.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = lines.add(f"MANIFOLD_SOLID_BREP('',{shell})")
    metre = lines.add(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({prefix},.METRE.))")
    radian = lines.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    sure = lines.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),{metre},'','')")
    context = lines.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)"
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({sure}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({metre},{radian}))REPRESENTATION_CONTEXT('',''))"
    )
    middle = lines.placed(lines.triple("CARTESIAN_POINT", (0, 0, 0)), (0, 0, 1), (1, 0, 0))
    shape = lines.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({middle},{solid}),{context})")
    design = lines.add("APPLICATION_CONTEXT('automotive design')")
    product = lines.add(f"PRODUCT_CONTEXT('',{design},'mechanical')")
    product = lines.add(f"PRODUCT('box','box','',({product}))")
    product = lines.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    design = lines.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{design},'design')")
    product = lines.add(f"PRODUCT_DEFINITION('design','',{product},{design})")
    product = lines.add(f"PRODUCT_DEFINITION_SHAPE('','',{product})")
    lines.add(f"SHAPE_DEFINITION_REPRESENTATION({product},{shape})")
    head = "FILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');"
    schema = "FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));"
    body = "\n".join(lines)
    return (
        f"ISO-10303-21;\nHEADER;\n{head}\n{schema}\nENDSEC;\nDATA;\n{body}\nENDSEC;\n"
        "END-ISO-10303-21;\n"
    )
