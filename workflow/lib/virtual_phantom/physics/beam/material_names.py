"""Names of the library's materials, and what people write for them. Loads nothing: every configuration needs it."""

from __future__ import annotations

# Name: compound of xraylib's NIST list, and density in g/cm^3 where it is not the listed one.
COMPOUNDS = {
    "water": ("Water, Liquid", None),
    "soft_tissue": ("Tissue, Soft (ICRU four-component)", None),
    "adipose": ("Adipose Tissue (ICRP)", None),
    "blood": ("Blood (ICRP)", None),
    "bone": ("Bone, Cortical (ICRP)", None),
    "pmma": ("Polymethyl Methacralate (Lucite, Perspex)", None),
    "polyethylene": ("Polyethylene", None),
    "cellulose": ("Cellulose Acetate, Cellophane", None),  # by its elements C6H10O5, cellulose
    "potassium_iodide": ("Potassium Iodide", None),
    "air": ("Air, Dry (near sea level)", None),
}
# Name: atomic number, and density in g/cm^3 at room temperature (CRC Handbook of Chemistry and Physics).
ELEMENTS = {
    "aluminium": (13, 2.699),
    "copper": (29, 8.96),
    "iodine": (53, 4.93),
    "tungsten": (74, 19.3),
    "molybdenum": (42, 10.22),
    "rhodium": (45, 12.41),
}
# What people write for them, beside capitals and spaces: trade names of PMMA, and American spelling.
SYNONYMS = {
    "acrylic": "pmma",
    "lucite": "pmma",
    "perspex": "pmma",
    "plexiglas": "pmma",
    "plexiglass": "pmma",
    "aluminum": "aluminium",
}


def named(material: object) -> object:
    """The library's name of a material that somebody wrote in capitals, with spaces, or as one of SYNONYMS.

    Parameters
    ----------
    material : object
        As it stands in a configuration, where it may be anything.

    Returns
    -------
    object
        A name of COMPOUNDS or ELEMENTS; what is none of the library's stays as it is.
    """
    if not isinstance(material, str):
        return material
    plain = "_".join(material.lower().replace("-", " ").replace("_", " ").split())
    plain = SYNONYMS.get(plain, plain)
    return plain if plain in COMPOUNDS or plain in ELEMENTS else material
