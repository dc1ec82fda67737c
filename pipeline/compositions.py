"""What `sixlight preview --scene` shows: the scenes with names, a mesh, a scene file.

Each is a `Composition`: one or two scenes, what they are of, and how their picture is laid out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calibration import estimate, metamers, sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError, fault
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra, read_spectra
from pipeline.files import meshes
from pipeline.files import scenes as scene_files
from pipeline.materials import Maker
from stages import scenes
from stages.facing import Side, facing
from stages.prefilter import irradiance
from stages.scene import Material, Scene
from stages.trichromatic import SPACES, Trichromatic
from stages.types import Float

NAMES = ("teapot", "colorchecker", "roughness", "metamers", "probe")
LIGHTS = "A,D65"
"""The two lights metamers are made for, as far as the map has them: tungsten lamp and daylight."""

ROUGHNESSES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
_LAMPS = "darling2011+cie-led+cie-fl3"  # whose names --lights knows
# Shares of the first light on the two sides that differ by less are one light to the eye.
_APART = 0.15


@dataclass(frozen=True)
class Composition:
    """A scene to be rendered, from one side or more, and what is to be said of it.

    name      of the files
    scene     seen from +Z
    aspect    width over height of each picture
    facing    where the viewer stands, degrees from +Z towards +X: one picture each
    headings  said of each picture; "" for nothing
    whites    XYZ (3,) of what is white in each picture, which is then exposed for it; None: the
              map's mean light, and the exposure by the picture
    alone     each thing is lit as if there were no other: samples to be compared
    turn_deg  of the environment, as a scene file has it
    said      by way of rendering (six, sharp, xyz), what to add to each caption
    figures   for --json
    spectra   files to be written beside the picture, by name
    notes     what was taken for granted
    """

    name: str
    scene: Scene
    aspect: float
    facing: tuple[float, ...] = (0.0,)
    headings: tuple[str, ...] = ("",)
    whites: tuple[Any, ...] = (None,)
    alone: bool = False
    turn_deg: float = 0.0
    said: dict[str, tuple[str, ...]] = field(default_factory=dict)
    figures: dict[str, Any] = field(default_factory=dict)
    spectra: dict[str, Spectra] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def compose(
    scene: str, light: Float, primaries: Primaries, *, lights: str = LIGHTS, seed: int = 1
) -> Composition:
    """The composition of a name, of a mesh's file or of a scene file.

    light    (6, N, N, P) the map without holes, for metamers, which are made for it
    lights   metamers': two names, or a CSV of two spectra
    seed     metamers'
    raises   InputError where there is no such thing, or it is wrong
    """
    maker = Maker(primaries)
    if scene == "teapot":
        # Patch 15, red: what a trichromatic renderer shows too orange under tungsten light.
        return Composition(scene, scenes.teapot(red(maker), stand(maker)), 1.0)
    if scene == "colorchecker":
        patches = [
            [maker.patch(str(k), roughness=0.1) for k in range(first, first + 6)]
            for first in (1, 7, 13, 19)
        ]
        return Composition(scene, scenes.grid(patches), scenes.grid_aspect(patches), alone=True)
    if scene == "roughness":
        return _roughness(maker)
    if scene == "probe":
        return _probe(maker)
    if scene == "metamers":
        return _metamers(light, primaries, maker, lights, seed)
    path = Path(scene)
    if path.suffix.lower() == ".toml":
        read = scene_files.read(path, primaries)
        return Composition(
            path.stem, read.scene, read.aspect, turn_deg=read.turn_deg, notes=read.notes
        )
    if path.suffix.lower() in meshes.FORMATS:
        return _mesh(path, maker)
    raise fault(
        f"no scene is called {scene!r}",
        f"{', '.join(NAMES)}, a mesh ({', '.join(meshes.FORMATS)}) or a scene file (.toml)",
        "choose one of these",
    )


def red(maker: Maker) -> Material:
    """What a shape is made of where nothing else is said."""
    return maker.patch("15", roughness=0.05)


def stand(maker: Maker) -> Material:
    """What shapes stand on."""
    return maker.patch("21", roughness=0.12)


def _mesh(path: Path, maker: Maker) -> Composition:
    mesh, notes = meshes.read(path)
    scene, scale = scenes.on_stand(mesh, red(maker), stand(maker))
    if not 0.8 < scale < 1.25:
        notes = (*notes, f"{path.name}: shown {scale:.3g} times its size, to fit the stand")
    return Composition(path.stem, scene, 1.0, notes=notes)


def _roughness(maker: Maker) -> Composition:
    """Nickel over a blue paint, ever rougher to the right."""
    rows = [
        [maker.metal("nickel", roughness=alpha) for alpha in ROUGHNESSES],
        [maker.patch("13", roughness=alpha) for alpha in ROUGHNESSES],
    ]
    alphas = ", ".join(f"{alpha:g}" for alpha in ROUGHNESSES)
    return Composition(
        "roughness",
        scenes.grid(rows),
        scenes.grid_aspect(rows),
        headings=(f"alpha {alphas}",),
        alone=True,
        figures={"roughness": list(ROUGHNESSES)},
    )


def _probe(maker: Maker) -> Composition:
    """What lighters put on a set: a mirror, a grey and a white sphere."""
    balls = [
        maker.grey(0.0, gloss=1.0, roughness=0.01),
        maker.grey(0.18),
        maker.grey(0.9),
    ]
    return Composition(
        "probe",
        scenes.grid([balls], background_level=0.0),
        scenes.grid_aspect([balls]),
        alone=True,
    )


# ---------------------------------------------------------------------------------------- metamers


def _metamers(
    light: Float, primaries: Primaries, maker: Maker, lights: str, seed: int
) -> Composition:
    """Two teapots that match where there is most of the first light and part on the other side."""
    named = _two_lights(lights)
    in_primaries = primaries.project(named.values.T)
    luminance = primaries.xyz_from_primaries[1]
    sides = facing(irradiance(light), in_primaries, luminance)
    if sides[0].share - sides[1].share < _APART:
        raise fault(
            f"a map with {sides[1].share:.0%} to {sides[0].share:.0%} of {named.names[0]}, the "
            f"rest {named.names[1]}, whichever way one faces",
            "two lights on two sides",
            "name two that are there with --lights, or show another scene",
        )
    match, part = (_spectrum(side, named, primaries) for side in sides)
    pair = metamers.pair(match, part, primaries, seed)
    first, second = (maker.paint(pair.paints[name]) for name in pair.paints.names)
    scene = scenes.metamers(first, second, maker.patch("23", roughness=0.2))
    whites = tuple(primaries.xyz_from_primaries @ side.irradiance for side in sides)
    matrix, bodies = primaries.xyz_from_primaries, (first.diffuse, second.diffuse)
    apart = {"six": [_difference(matrix, side.irradiance, *bodies) for side in sides]}
    for way in SPACES:
        three = Trichromatic.named(way, primaries)
        shown = [three.surface(body) for body in bodies]
        apart[way] = [
            _difference(three.xyz_from_channels, three.light(s.irradiance), *shown) for s in sides
        ]
    falling = Spectra(WAVELENGTHS, ("match", "part"), np.stack([match, part], axis=1))
    return Composition(
        "metamers",
        scene,
        1.6,
        facing=tuple(side.azimuth_deg for side in sides),
        headings=tuple(f"where {name} prevails" for name in named.names),
        whites=whites,
        said={way: tuple(f"dE {d:.1f} apart" for d in both) for way, both in apart.items()},
        figures={
            "lights": list(named.names),
            "facing_deg": [s.azimuth_deg for s in sides],
            "share_of_first_light": [s.share for s in sides],
            "paints": pair.figures,
            "delta_e": {
                way: dict(zip(("match", "part"), d, strict=True)) for way, d in apart.items()
            },
        },
        spectra={"paints": pair.paints, "lights": falling},
    )


def _two_lights(lights: str) -> Spectra:
    """Two spectra on the common grid, each with Y = 1."""
    if lights.lower().endswith(".csv"):
        try:
            found = read_spectra(lights, kind="power").resampled()
        except InputError as error:
            raise error.at(lights) from None
        if len(found) != 2:
            raise fault(f"{len(found)} spectra", "two lights", "leave two columns", lights)
    else:
        known = sets.lights(_LAMPS)
        names = [name.strip() for name in lights.split(",")]
        if len(names) != 2 or names[0] == names[1] or not set(names) <= set(known.names):
            raise fault(
                f"lights {lights!r}",
                "two of A, D65, F1 .. F12, LED-B1 and others, as in A,D65; or a CSV of two spectra",
                "name two",
            )
        found = known.only(names)
    return Spectra(found.wavelengths, found.names, sets.scaled_to_unit_luminance(found.values))


def _spectrum(side: Side, named: Spectra, primaries: Primaries):
    """The light (36,) on a side: the mixture of the two that is nearest, and what it leaves over.

    The rest, walls' colours and errors of measurement, is known in the primaries alone; estimated
    as a spectrum it makes that of the light agree with the map to the last digit.
    """
    mixture = named.values @ side.amounts
    rest = side.irradiance - primaries.project(mixture)
    return mixture + estimate.spectra_from_primaries(primaries, "light") @ rest


def _difference(xyz_from_channels, light, first, second) -> float:
    """CIEDE2000 of two matt surfaces in a light, to an eye adapted to it."""
    white = xyz_from_channels @ light
    to_d65 = cat02(white / white[1], D65) / white[1]
    colours = [lab(to_d65 @ (xyz_from_channels @ (light * body))) for body in (first, second)]
    return float(delta_e_2000(*colours))
