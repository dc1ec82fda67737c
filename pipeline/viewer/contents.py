"""What the page is told: everything that Python knows and JavaScript should not know again.

Which form of the light a roughness sees, how many samples it asks for, how XYZ is adapted, what a
spectrum may have been: each is a number here, made by the function that makes it everywhere else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import shaders
from calibration import adaptation, chromaticity, display, estimate
from calibration.adaptation import METHODS
from calibration.display import SHOULDER, SRGB
from calibration.errors import InputError
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS
from pipeline.previews import OF_WHITE
from pipeline.viewer.models import MODELS, ROUGHNESSES, Models, Shape, rounded
from pipeline.viewer.packing import Pack, code
from stages import cube
from stages.light import Light, form
from stages.scene import BRDFS
from stages.trichromatic import Trichromatic
from stages.view import View

_WHITES = ("D65", "D50", "A", "E")
_SIGMA_STEPS = 4  # codes of sigma for each factor of two
_PROGRAMS = (
    "surface.vert",
    "surface.frag",
    "screen.vert",
    "environment.frag",
    "latlong.frag",
    "reduce.frag",
    "display.frag",
    *(f"{brdf}.frag" for brdf in BRDFS),
)
_LOBES = {"ward": "Ward, bounded", "ward1992": "Ward 1992", "ggx": "GGX"}


def contents(
    name: str, unit: str, view: View, primaries: Primaries
) -> tuple[dict[str, Any], Sequence[Shape]]:
    """All that the page is told of a map, but for the numbers that `pack` has; and its shapes.

    name, unit  of the map, in words
    """
    stage = Models(primaries)
    whole = view.light.whole.mips[0]
    light = whole * np.float32(view.scale)  # metamers are made for it
    notes = []
    if view.finer > 1:
        notes.append(f"each texel is the mean of {view.finer} x {view.finer} of the file's")
    models = []
    whites: dict[str, Any] = {"map": primaries.xyz_from_primaries @ view.mean}
    for model in MODELS:
        try:
            made, its_whites = stage.model(model, light)
        except InputError as error:
            notes += [f"{MODELS[model]}: left out, {problem.found}" for problem in error.problems]
            continue
        models.append(made)
        whites |= its_whites
    three = Trichromatic.named("sharp", primaries)
    each = np.eye(len(primaries.channels))
    told = {
        "name": name,
        "unit": unit,
        "facts": [
            ("Values", unit),
            ("Primaries", f"{primaries.name}, {len(primaries.channels)} channels"),
            ("Map", f"{whole.shape[1]} texels along a face"),
            ("Models", "cast no shadows here; `sixlight preview` draws them with theirs"),
        ],
        "notes": notes,
        "channels": _channels(primaries),
        "map": {
            "size": whole.shape[1],
            "scale": view.scale,
            "faces": _faces(),
            "sigma": {"largest": _largest(view.sigma), "steps": _SIGMA_STEPS},
        },
        "ways": {
            "six": {"xyz": primaries.xyz_from_primaries.tolist()},
            "three": {
                "xyz": three.xyz_from_channels.tolist(),
                "light": three.light(each).T.tolist(),
                "surface": three.surface(each).T.tolist(),
            },
        },
        "forms": _forms(view.light),
        "roughnesses": [{"alpha": a, "form": form(a)} for a in ROUGHNESSES],
        "lobes": [{"id": brdf, "label": _LOBES[brdf]} for brdf in BRDFS],
        "models": models,
        "shapes": [{"name": f"shape.{k}", "extent": s.extent} for k, s in enumerate(stage.shapes)],
        "materials": stage.materials,
        "glosses": stage.glosses,
        "look": _look(whites),
        "spectrum": {
            "nm": WAVELENGTHS.tolist(),
            "estimate": rounded(estimate.spectra_from_primaries(primaries)),
            "deviation": rounded(estimate.deviation(primaries)),
        },
        "locus": rounded(chromaticity.planckian_locus()),
        "shaders": {file: shaders.load(file, shaders.ES_VERSION).text for file in _PROGRAMS},
    }
    return told, stage.shapes


def pack(view: View, shapes: Sequence[Shape], bits: int) -> Pack:
    """The numbers: maps, what is known of their error, the meshes of the models.

    bits  of half floats after the point, as `packing.code` takes them
    """
    packed = Pack()
    _pack_light(view.light, packed, bits)
    packed.bytes("sigma", _sigma_steps(view.sigma))
    packed.bytes("valid", np.round(255 * view.valid).astype(np.uint8)[..., None])
    for number, shape in enumerate(shapes):
        shape.pack(f"shape.{number}", packed)
    return packed


# ----------------------------------------------------------------------------- the map


def _pack_light(light: Light, packed: Pack, bits: int) -> None:
    """Three forms of mips, and the irradiance: whole.0, whole.1 ... matt.0."""
    whole = [code(mip, bits) for mip in light.whole.mips]
    packed.cube("whole.0", whole[0])
    _pack_mips("whole", whole, packed)
    if light.narrow is not light.whole:
        for level, mip in enumerate(light.narrow.mips):
            packed.like(f"narrow.{level}", code(mip, bits), f"whole.{level}", whole[level])
    broad = [code(mip, bits) for mip in light.broad.mips]
    packed.cube("broad.0", broad[0])
    _pack_mips("broad", broad, packed)
    packed.cube("matt.0", code(light.matt.irradiance, bits))


def _faces() -> list[Any]:
    """Per face the vectors a, b, c of direction = a + u b + v c, as stages/cube.py has them."""
    a = cube.face_directions(0.0, 0.0)
    b, c = (np.sqrt(2) * cube.face_directions(*uv) - a for uv in ((1.0, 0.0), (0.0, 1.0)))
    return list(np.round(np.stack([a, b, c], axis=1)).tolist())


def _pack_mips(name: str, levels, packed: Pack) -> None:
    for level in range(1, len(levels)):
        packed.mip(f"{name}.{level}", levels[level], f"{name}.{level - 1}", levels[level - 1])


def _largest(sigma) -> float:
    known = sigma[np.isfinite(sigma)]
    return float(known.max()) if known.size and known.max() > 0 else 1.0


def _sigma_steps(sigma):
    """Sigma as bytes: 255 the largest, each less a step of a factor of two; 0 not known."""
    known = np.isfinite(sigma) & (sigma > 0)
    steps = np.zeros(sigma.shape)
    steps[known] = 255 + np.round(_SIGMA_STEPS * np.log2(sigma[known] / _largest(sigma)))
    return np.where(known, np.maximum(steps, 1), 0).astype(np.uint8)


def _forms(light: Light) -> dict[str, Any]:
    """Which arrays are each form's mips, and its lamps."""

    def lamps(part) -> dict[str, Any]:
        return {"directions": rounded(part.directions), "flux": rounded(part.flux)}

    forms: dict[str, Any] = {}
    for name in ("whole", "narrow", "broad"):
        part = getattr(light, name)
        source = "whole" if part is light.whole else name
        forms[name] = {
            "mips": [f"{source}.{level}" for level in range(len(part.mips))],
            **lamps(part),
        }
    return forms | {"matt": {"mips": ["matt.0"], **lamps(light.matt)}}


def _channels(primaries: Primaries) -> list[dict[str, Any]]:
    """Name, peak and a colour to draw each in: its own light, brought into sRGB, and bright."""
    xyz = primaries.xyz_from_primaries.T
    linear = display.decode(display.srgb(xyz / xyz.max(axis=1, keepdims=True), exposure=0.3))
    colours = display.encode(0.85 * linear / linear.max(axis=1, keepdims=True))
    return [
        {
            "name": channel,
            "peak_nm": round(float(peak), 1),
            "width_nm": round(float(width), 1),
            "colour": "rgb({} {} {})".format(*np.round(255 * colour).astype(int)),
        }
        for channel, peak, width, colour in zip(
            primaries.channels, primaries.peaks_nm, primaries.widths_nm, colours, strict=True
        )
    ]


# ------------------------------------------------------------------------------- how it is shown


def _look(whites: Mapping[str, Any]) -> dict[str, Any]:
    """Adapting matrices by method and white, and for whites with a level the exposure they ask for.

    Adaptation by a degree D is D times the matrix plus 1 - D times the identity.
    """
    known = {name: adaptation.white(name) for name in _WHITES}
    matrices: dict[str, Any] = {}
    for method in METHODS:
        matrices[method] = {}
        for name, white in {**whites, **known}.items():
            try:
                matrices[method][name] = adaptation.adapt(white, SRGB.white, method).tolist()
            except InputError:  # no light has such a colour: nobody adapts to it
                continue
    named = [name for name in {**whites, **known} if all(name in m for m in matrices.values())]
    return {
        "whites": [{"id": name, "label": _white_label(name)} for name in named],
        "adaptation": matrices,
        "exposure_ev": {
            name: float(np.log2(SHOULDER / (OF_WHITE * white[1])))
            for name, white in whites.items()
            if white[1] > 0
        },
        "rgb_from_xyz": SRGB.rgb_from_xyz.tolist(),
        "knee": SHOULDER,
    }


def _white_label(name: str) -> str:
    if name == "map":
        return "Of the map"
    side, _, where = name.partition(":")
    return f"Where {where} prevails" if side == "side" else f"Illuminant {name}"
