"""Names of the library's materials and their synonyms. This module has no imports, so configurations load fast."""

from __future__ import annotations

# Name: compound of xraylib's NIST list, and density in g/cm^3 if it differs from the listed one.
COMPOUNDS = {
    "water": ("Water, Liquid", None),
    "soft_tissue": ("Tissue, Soft (ICRU four-component)", None),
    "adipose": ("Adipose Tissue (ICRP)", None),
    "blood": ("Blood (ICRP)", None),
    "bone": ("Bone, Cortical (ICRP)", None),
    "pmma": ("Polymethyl Methacralate (Lucite, Perspex)", None),
    "polyethylene": ("Polyethylene", None),
    "cellulose": ("Cellulose Acetate, Cellophane", None),  # its elements, C6H10O5, are those of cellulose
    "potassium_iodide": ("Potassium Iodide", None),
    "air": ("Air, Dry (near sea level)", None),
}
# Name: atomic number, and density in g/cm^3 at ambient temperature (CRC Handbook of Chemistry and Physics).
ELEMENTS = {
    "aluminium": (13, 2.699),
    "copper": (29, 8.96),
    "iodine": (53, 4.93),
    "tungsten": (74, 19.3),
    "molybdenum": (42, 10.22),
    "rhodium": (45, 12.41),
}
# Trade names of PMMA, and American spelling.
SYNONYMS = {
    "acrylic": "pmma",
    "lucite": "pmma",
    "perspex": "pmma",
    "plexiglas": "pmma",
    "plexiglass": "pmma",
    "aluminum": "aluminium",
}


def library_name(material: object) -> object:
    """Return the library's name of a material written with capitals, spaces or a synonym.

    Returns
    -------
    object
        Name in COMPOUNDS or ELEMENTS; any other entry is returned unchanged.
    """
    if not isinstance(material, str):
        return material
    plain = "_".join(material.lower().replace("-", " ").replace("_", " ").split())
    plain = SYNONYMS.get(plain, plain)
    return plain if plain in COMPOUNDS or plain in ELEMENTS else material
