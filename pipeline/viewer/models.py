"""The page's models and materials, made of what previews are made of, each shape told once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.primaries import Primaries
from pipeline.compositions import Composition, compose, red, stand
from pipeline.materials import Maker
from pipeline.viewer.packing import Pack
from stages.light import form
from stages.meshes import sphere
from stages.renderer import by_root, samples_of
from stages.scene import Material, Mesh
from stages.scenes import on_stand, teapot
from stages.types import Float

MODELS = {
    "teapot": "Teapot",
    "sphere": "Sphere",
    "colorchecker": "ColorChecker",
    "metamers": "Metamer pair",
    "roughness": "Roughnesses",
    "probe": "Light probes",
}
_CHOSEN = ("teapot", "sphere")  # of a material that the viewer chooses
# fmt: off
ROUGHNESSES = (
    0.01, 0.012, 0.015, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15,
    0.18, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6,
)
# fmt: on
_ALIKE = 1e-6  # metres and shares of a unit normal


@dataclass(frozen=True)
class Shape:
    """A mesh about its middle.

    places     (V, 3) metres from there
    normals    (V, 3)
    triangles  (T, 3)
    """

    places: Float
    normals: Float
    triangles: Any

    @property
    def extent(self) -> float:
        """The farthest that a coordinate is from the middle, metres."""
        return float(np.abs(self.places).max())

    def same(self, other: Shape) -> bool:
        return np.array_equal(self.triangles, other.triangles) and all(
            a.shape == b.shape and np.allclose(a, b, rtol=0, atol=_ALIKE)
            for a, b in ((self.places, other.places), (self.normals, other.normals))
        )

    def pack(self, name: str, pack: Pack) -> None:
        """Places in 1/32767 of the extent, normals in 1/32767."""
        pack.vectors(f"{name}.places", np.round(32767 / self.extent * self.places))
        pack.vectors(f"{name}.normals", np.round(32767 * self.normals))
        pack.vectors(f"{name}.triangles", self.triangles)


class Models:
    """Models as they are asked for; shapes, materials and glosses are collected meanwhile.

    shapes     that the models' things are of, by number
    materials  first those a viewer may choose, which have a label, then the models' own
    glosses    specular reflectances of materials: (P,), or (steps, P) by angle as shade.glsl has it
    """

    def __init__(self, primaries: Primaries) -> None:
        self.shapes: list[Shape] = []
        self.materials: list[dict[str, Any]] = []
        self.glosses: list[Any] = []
        self._primaries = primaries
        make = self._make = Maker(primaries)
        self._chosen = red(make)
        for label, material in (
            ("Red paint", make.patch("15")),
            ("Blue paint", make.patch("13")),
            ("Green paint", make.patch("14")),
            ("Yellow paint", make.patch("16")),
            ("Skin", make.patch("2")),
            ("White paint", make.patch("19")),
            ("Grey paint", make.patch("22")),
            ("Nickel", make.metal("nickel", roughness=0.1)),
            ("Silver", make.metal("silver", roughness=0.1)),
            ("Ideal mirror", make.grey(0.0, gloss=1.0)),
            ("Matt white", make.grey(0.9)),
        ):
            self._material(material, label)

    def model(self, name: str, light: Float) -> tuple[dict[str, Any], dict[str, Any]]:
        """One of MODELS, and the XYZ of whites that belong to it, by name.

        light   (6, N, N, P) the map without holes
        raises  InputError where it cannot be shown in this light
        """
        if name == "teapot":
            composed = Composition(name, teapot(self._chosen, stand(self._make)), 1.0)
        elif name == "sphere":
            mesh = sphere(radius=0.1, segments=64)
            ball, _ = on_stand(mesh, self._chosen, stand(self._make))
            composed = Composition(name, ball, 1.0)
        else:
            composed = compose(name, light, self._primaries)
        sides, whites = _sides(composed)
        return self._told(composed) | sides, whites

    def _told(self, composed: Composition) -> dict[str, Any]:
        camera, name = composed.scene.camera, composed.name
        away = np.subtract(camera.eye, camera.target)
        distance = float(np.linalg.norm(away))
        return {
            "id": name,
            "label": MODELS[name],
            "aspect": composed.aspect,
            "view_deg": camera.vertical_view_deg,
            "distance": distance,
            "pitch": float(np.degrees(np.arcsin(away[1] / distance))),
            "target": list(camera.target),
            "blur": composed.scene.background_level,
            "chosen": name in _CHOSEN,
            "rough": name == "colorchecker",
            "things": [self._thing(mesh, material) for mesh, material in composed.scene.things],
        }

    def _thing(self, mesh: Mesh, material: Material) -> dict[str, Any]:
        """A shape's number, where its middle lies, and a material's; None: the chosen one."""
        at = (mesh.positions.min(axis=0) + mesh.positions.max(axis=0)) / 2
        shape = Shape(mesh.positions - at, mesh.normals, mesh.triangles)
        known = [number for number, other in enumerate(self.shapes) if shape.same(other)]
        if not known:
            known = [len(self.shapes)]
            self.shapes.append(shape)
        made = None if material is self._chosen else self._material(material)
        return {"shape": known[0], "at": rounded(at), "material": made}

    def _material(self, material: Material, label: str = "") -> int:
        """The number of a material, with how many samples it asks for in each form of the light."""
        specular = np.asarray(material.specular, np.float64)
        gloss = rounded(by_root(specular) if specular.ndim == 2 else specular, 5)
        if gloss not in self.glosses:
            self.glosses.append(gloss)
        forms = {form(alpha): alpha for alpha in (*ROUGHNESSES, material.roughness)}
        told = {
            "label": label,
            "diffuse": rounded(material.diffuse),
            "gloss": self.glosses.index(gloss),
            "alpha": material.roughness,
            "form": form(material.roughness),
            "samples": {
                seen: samples_of(Material(material.diffuse, specular, alpha))
                for seen, alpha in forms.items()
            },
        }
        if told not in self.materials:
            self.materials.append(told)
        return self.materials.index(told)


def _sides(composed: Composition) -> tuple[dict[str, Any], dict[str, Any]]:
    """Where a viewer of metamers stands to see them match and part, and what is white there."""
    if len(composed.facing) == 1:
        return {}, {}
    apart = composed.figures["delta_e"]
    sides, whites = [], {}
    for facing, heading, lamp, white, kind in zip(
        composed.facing,
        composed.headings,
        composed.figures["lights"],
        composed.whites,
        ("match", "part"),
        strict=True,
    ):
        whites[f"side:{lamp}"] = white
        sides.append(
            {
                "label": heading,
                "turn": -facing % 360.0,
                "white": f"side:{lamp}",
                "apart": {
                    "six": round(apart["six"][kind], 1),
                    "three": round(apart["sharp"][kind], 1),
                },
            }
        )
    return {"sides": sides}, whites


def rounded(values, digits: int = 7) -> list[Any]:
    """Numbers as lists, no longer than single floats need."""
    values = np.asarray(values, np.float64)
    short = [float(f"{v:.{digits}g}") for v in values.ravel()]
    return list(np.reshape(short, values.shape).tolist())
