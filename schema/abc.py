"""The original file formats of the ABC dataset: names of files, keys of features.

Shared by the exporter (``queries.abc``) and the importer (``ingest.abc``). Meanings follow the
paper's appendix, "Curve and Patch Features", and the published files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from breplake.errors import UsageError

__all__ = [
    "ABC_FORMAT",
    "CONTINUITY_CODES",
    "CURVE_KEYS",
    "EXTENSIONS",
    "SURFACE_KEYS",
    "AbcName",
    "file_name",
    "parse_name",
]

ABC_FORMAT: Final = "abc"
"""``models.format`` of models that were read from these files alone."""

EXTENSIONS: Final = {
    "trimesh": ".obj",
    "features": ".yml",
    "stats": ".yml",
    "metadata": ".yml",
}
"""Kinds of files that belong to one model, with their extensions. STEP files come on top."""

_AXES: Final = ("location", "x_axis", "y_axis", "z_axis")

CURVE_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "Line": ("location", "direction"),
    "Circle": (*_AXES, "radius"),
    "Ellipse": ("focus1", "focus2", "x_axis", "y_axis", "z_axis", "x_radius", "y_radius"),
    "BSpline": ("rational", "closed", "continuity", "degree", "poles", "knots", "weights"),
    "Other": (),
}
"""Keys of each type of curve, besides ``type``, ``sharp``, ``vert_indices``, ``vert_parameters``.

The published files call the radii of an ellipse ``maj_radius`` and ``min_radius``.
"""

SURFACE_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "Plane": (*_AXES, "coefficients"),
    "Cylinder": (*_AXES, "coefficients", "radius"),
    "Cone": (*_AXES, "coefficients", "radius", "angle", "apex"),
    "Sphere": (*_AXES, "coefficients", "radius"),
    "Torus": (*_AXES, "max_radius", "min_radius"),
    "Revolution": ("location", "z_axis", "curve"),
    "Extrusion": ("direction", "curve"),
    "BSpline": (
        *("u_rational", "v_rational", "u_closed", "v_closed", "continuity"),
        *("u_degree", "v_degree", "poles", "u_knots", "v_knots", "weights"),
    ),
    "Other": (),
}
"""Keys of each type of patch, besides ``type``, ``vert_indices``, ``vert_parameters``,
``face_indices``. The paper does not list the radius of the cylinder; the files have it."""

CONTINUITY_CODES: Final = {0: 0, 2: 1, 4: 2, 5: 3, 6: 99}
"""Value of ``continuity`` in the files, a ``GeomAbs_Shape`` of OCCT, to the order of
continuity in a lake. The codes 1 and 3 (G1, G2) do not occur on splines."""

_NAME: Final = re.compile(
    r"(?P<stem>.+)_(?P<kind>step|trimesh|features|stats|metadata)_(?P<part>\d{3})"
    r"(?P<variant>(?:\.[^./]+)*)(?P<extension>\.[a-z0-9]+)",
    re.IGNORECASE,
)

_DOCUMENT: Final = re.compile(r"\d{8}_[0-9a-f]{24}")
"""Id and document hash with which names of ABC models begin."""

_MODEL: Final = re.compile(rf"({_DOCUMENT.pattern})_(\d{{3}})")

_UNSAFE: Final = re.compile(r'[\x00-\x1f\x7f%/\\<>:"|?*]|^\.')
"""What a file name does not bear everywhere, and the sign that escapes it."""

_LONGEST: Final = 255
"""Bytes that a file name may have."""


@dataclass(frozen=True, slots=True)
class AbcName:
    """What the name of a file says.

    Parameters
    ----------
    model : str
        Name of the model.
    kind : str
        ``step``, or a key of `EXTENSIONS`.
    """

    model: str
    kind: str


def parse_name(name: str) -> AbcName | None:
    """Read the name of a file; None if it is not named like one of an ABC model.

    ``00000050_80d90bfdd2e74e709956122a_features_000.yml`` belongs to the model
    ``00000050_80d90bfdd2e74e709956122a_000``. Any other name before ``_features_000.yml`` is a
    model's whole name, in which ``%2F`` stands for ``/``: the inverse of `file_name`. Only files
    of original names count as ABC's STEP files, since any part may be called ``a_step_001``;
    that they are STEP at all is for the caller to see.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    stem, kind = match["stem"], match["kind"].lower()
    original = _DOCUMENT.fullmatch(stem) is not None
    if kind == "step":
        if not original or match["variant"]:
            return None
    elif match["extension"].lower().replace(".yaml", ".yml") != EXTENSIONS[kind]:
        return None
    if not original:
        stem = re.sub("%([0-9A-F]{2})", lambda code: chr(int(code[1], 16)), stem)
    numbered = original or match["part"] != "000"
    return AbcName(
        stem + (f"_{match['part']}" if numbered else "") + match["variant"],
        kind,
    )


def file_name(model: str, kind: str) -> str:
    """Return the name of a model's file of a kind.

    Parameters
    ----------
    model : str
        Name of the model.
    kind : str
        A key of `EXTENSIONS`.

    Raises
    ------
    UsageError
        If the name would be longer than file systems allow.
    """
    match = _MODEL.fullmatch(model)
    if match is not None:
        stem, part = match[1], match[2]
    else:
        stem = _UNSAFE.sub(lambda found: f"%{ord(found[0]):02X}", model)
        if _DOCUMENT.fullmatch(stem):
            stem = stem.replace("_", "%5F")  # else it would be read as a document's first part
        part = "000"
    name = f"{stem}_{kind}_{part}{EXTENSIONS[kind]}"
    if len(name.encode("utf-8", "surrogatepass")) > _LONGEST:
        raise UsageError(
            f"the file {name} of model {model} would have a name of more than {_LONGEST} bytes; "
            "ingest it from a path with shorter names"
        )
    return name
