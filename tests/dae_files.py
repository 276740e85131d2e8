"""COLLADA files for tests, written by hand."""

TEXT = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}<up_axis>{up_axis}</up_axis></asset>
<library_geometries>{geometries}</library_geometries>
<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
GEOMETRY = """<geometry id="g{number}"><mesh><source id="p{number}">
<float_array id="a{number}" count="{count}">{positions}</float_array>
<technique_common><accessor source="#a{number}" count="{vertices}" stride="3"/></technique_common></source>
<vertices id="v{number}"><input semantic="POSITION" source="#p{number}"/></vertices>{faces}</mesh></geometry>"""
INPUTS = (
    '<input semantic="NORMAL" source="#p{number}" offset="0"/><input semantic="VERTEX" source="#v{number}" offset="1"/>'
)


def words(values):
    return " ".join(str(value) for value in values)


def corners(faces):
    """Return the indices of `faces`, behind one of a normal each."""
    return words(f"0 {vertex}" for face in faces for vertex in face)


def triangles(faces, number):
    return f"<triangles count='{len(faces)}'>{INPUTS.format(number=number)}<p>{corners(faces)}</p></triangles>"


def polylist(faces, number):
    counts = words(len(face) for face in faces)
    inputs = INPUTS.format(number=number)
    return f"<polylist count='{len(faces)}'>{inputs}<vcount>{counts}</vcount><p>{corners(faces)}</p></polylist>"


def polygons(faces, number, kind="polygons"):
    lists = "".join(f"<p>{corners([face])}</p>" for face in faces)
    return f"<{kind} count='{len(faces)}'>{INPUTS.format(number=number)}{lists}</{kind}>"


def collada(parts, unit='<unit name="meter" meter="1"/>', up_axis="Z_UP"):
    """Return the file of `parts`: vertices, the XML of their faces as a function of a number, and that of a node."""
    geometries, nodes = [], []
    for number, (vertices, faces, place) in enumerate(parts):
        numbers = [repr(float(x)) for vertex in vertices for x in vertex]
        values = {"number": number, "count": len(numbers), "vertices": len(vertices), "positions": words(numbers)}
        geometries.append(GEOMETRY.format(**values, faces=faces(number)))
        nodes.append(f'<node id="n{number}">{place}<instance_geometry url="#g{number}"/></node>')
    return TEXT.format(unit=unit, up_axis=up_axis, geometries="".join(geometries), nodes="".join(nodes))
