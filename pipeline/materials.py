"""Materials from words and files: what a scene file's [material.NAME] says, in the primaries.

A reflectance is a number; a patch of a set that ships, "colorchecker24:15"; a spectrum,
"paint.csv" or one column of it, "paints.csv:ochre"; and for the body also an image of reflectance
in the same primaries, "painting.exr". A gloss is such a reflectance, a refractive index, or a
metal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration import metals, sets
from calibration.errors import InputError, fault
from calibration.primaries import Primaries
from calibration.spectra import read_spectra
from pipeline import io
from pipeline.files import header as headers
from pipeline.files.tables import Table
from stages.scene import BRDFS, Material

# Steps of the cosine at which a gloss is tabulated by angle: between two of them, Fresnel's
# reflectance of glass is straight to .004.
ANGLES = 33
# What noise, fluorescence and signed primaries may add to a white.
_ROOM = 0.02
INDEX = 1.5  # of varnishes, plastics and glazes


@dataclass(frozen=True)
class Maker:
    """What materials are made for, and where their files may lie.

    primaries  they are reduced to
    folder     of the files they name; None: nowhere, as none is named
    notes      grows with what was taken for granted
    """

    primaries: Primaries
    folder: Path | None = None
    notes: list[str] = field(default_factory=list)

    def paint(self, spectrum, *, roughness: float = 0.1, index: float = INDEX) -> Material:
        """A body of one reflectance (36,) under a colourless varnish."""
        return Material(self.primaries.project(spectrum), self.varnish(index), roughness)

    def patch(self, name: str, *, roughness: float = 0.1, index: float = INDEX) -> Material:
        """A ColorChecker's patch, 1 .. 24, as a glossy paint."""
        return self.paint(_chart()[name], roughness=roughness, index=index)

    def metal(self, name: str | Path, *, roughness: float) -> Material:
        """A bare metal, by its name or a CSV of wavelength_nm,n,k."""
        table = metals.in_primaries(self.primaries, _angles(), material=name)
        return Material(np.zeros(self._count), table, roughness)

    def grey(self, reflectance: float, *, gloss: float = 0.0, roughness: float = 0.5) -> Material:
        """A neutral body, and a gloss that does not change with the angle."""
        return Material(np.full(self._count, reflectance), np.full(self._count, gloss), roughness)

    def varnish(self, index: float) -> NDArray[np.float64]:
        """The reflectance (K, P) by angle of a clear coat: Fresnel's, the same in all channels."""
        return np.repeat(metals.fresnel(index, _angles())[:, None], self._count, axis=1)

    @property
    def _count(self) -> int:
        return len(self.primaries.channels)

    # -------------------------------------------------------------------------- from a scene file

    def read(self, table: Table) -> Material | None:
        """The material a TOML table describes; None, and its problems noted, where it is wrong.

        diffuse    a reflectance, as this module's first lines say; 0 for a metal
        specular   a reflectance, the same at all angles; or
        index      of refraction of a clear coat, 1 .. 4; or
        metal      a name of `calibration.metals`, or a CSV of wavelength_nm,n,k
        roughness  alpha in (0, 1], or two of them: along the tangents and across
        brdf       ward, ward1992 or ggx
        """
        known = len(table.problems)
        diffuse_word = table.word("diffuse")
        specular_word = table.word("specular")
        index = table.number("index", "refractive index", low=1.0, high=4.0)
        metal = table.text("metal")
        roughness = _roughness(table)
        brdf = table.text("brdf", BRDFS[0])
        if brdf not in BRDFS:
            table.wrong("brdf", repr(brdf), ", ".join(BRDFS), "choose one")
        glosses = [k for k in ("specular", "index", "metal") if k in table.content]
        if len(glosses) > 1:
            table.wrong("", f"given {' and '.join(glosses)}", "one kind of gloss", "choose one")
        if diffuse_word is None and metal is None and "diffuse" not in table.content:
            table.wrong("diffuse", "missing", "a reflectance, or metal", "add one of them")
        table.nothing_else()
        image = None
        diffuse = specular = np.zeros(self._count)
        if diffuse_word is not None:
            with table.noting("diffuse"):
                diffuse, image = self._body(diffuse_word)
        with table.noting("/".join(glosses) or "index"):
            if metal is not None:
                specular = self.metal(self._metal(metal), roughness=1.0).specular
            elif specular_word is not None:
                specular = self.primaries.project(self._spectrum(specular_word))
            else:
                specular = self.varnish(index or INDEX)
        if len(table.problems) > known:
            return None
        made = Material(diffuse, specular, roughness, brdf or BRDFS[0], image)
        _check_albedo(table, made)
        return made if len(table.problems) == known else None

    def _body(self, word: str | float):
        """rho_d (P,), and an image of it (H, W, P) or None."""
        if isinstance(word, str) and word.lower().endswith(".exr"):
            image = self._image(word)
            return image.reshape(-1, image.shape[-1]).mean(axis=0, dtype=np.float64), image
        return self.primaries.project(self._spectrum(word)), None

    def _spectrum(self, word: str | float) -> NDArray[np.float64]:
        """A reflectance (36,) of a number, a set's patch or a CSV."""
        if not isinstance(word, str):
            if not 0.0 <= word <= 1.0:
                raise fault(f"{word:g}", "a reflectance from 0 to 1", "correct it")
            return np.full(len(self.primaries.curves), float(word))
        name, _, column = word.partition(":")
        if name.lower().endswith(".csv"):
            path = self.file(name)
            spectra = read_spectra(path, kind="fraction")
        elif name in sets.SURFACES:
            path = None
            spectra = sets.surfaces(name)
        else:
            raise fault(
                repr(word),
                f"a number, a CSV of spectra, or a patch of {', '.join(sets.SURFACES)}, as in "
                "colorchecker24:15",
                "name one",
            )
        if not column and len(spectra) == 1:
            column = spectra.names[0]
        if column not in spectra.names:
            names = ", ".join(spectra.names[:8]) + (", ..." if len(spectra) > 8 else "")
            found = f"no spectrum {column!r}" if column else f"{len(spectra)} spectra, none named"
            raise fault(found, names, f"write it as {name}:NAME", path or name)
        try:
            return spectra.only([column]).resampled().values[:, 0]
        except InputError as error:
            raise error.at(path or name) from None

    def _image(self, word: str) -> NDArray[np.float32]:
        """An image (H, W, P) of reflectance; holes take the mean of what is known."""
        path = self.file(word)
        measured, names = io.read_measured(path)
        header = io.read_exr(path)[2]
        if header.get("quantity") != "reflectance":
            raise fault(
                f"quantity {header.get('quantity', '')!r} in its header",
                "'reflectance'",
                "give what `sixlight reflectance` or `spectra --kind reflectance` wrote",
                path,
            )
        if names != self.primaries.channels or not headers.has_matrix(header, self.primaries):
            raise fault(
                f"the primaries {header.get('primaries', '')!r}, {len(names)} channels",
                f"{self.primaries.name!r}, those of the light",
                "make it again with --primaries",
                path,
            )
        known = np.isfinite(measured.values).all(axis=-1) & (measured.valid > 0)
        if not known.any():
            raise fault("nothing in it is known", "pixels with values", "make it again", path)
        if not known.all():
            self.notes.append(
                f"{path.name}: {1 - known.mean():.1%} of it is not known: taken for its mean"
            )
        image = np.where(known[..., None], measured.values, measured.values[known].mean(axis=0))
        return np.asarray(image, np.float32)

    def _metal(self, word: str) -> str | Path:
        return self.file(word) if word.lower().endswith(".csv") else word

    def file(self, name: str) -> Path:
        """A file below the folder of the scene."""
        assert self.folder is not None
        path = self.folder / name
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise fault(f"{name!r}, outside the scene's folder", "a file below it", "move it there")
        if not path.is_file():
            raise fault("no such file", "a file beside the scene", "check the name", path)
        return path


def _roughness(table: Table) -> float | tuple[float, float]:
    value = table.raw("roughness")
    value = 0.1 if value is None else value
    both = value if isinstance(value, list) else [value]
    if len(both) not in (1, 2) or not all(
        isinstance(a, int | float) and not isinstance(a, bool) and 0.0 < a <= 1.0 for a in both
    ):
        table.wrong(
            "roughness", repr(value), "alpha above 0 and at most 1, or two of them", "correct it"
        )
        return 0.1
    return float(both[0]) if len(both) == 1 else (float(both[0]), float(both[1]))


def _check_albedo(table: Table, material: Material) -> None:
    """No surface returns more light than it receives; looked at head on."""
    gloss = material.specular[0] if np.ndim(material.specular) == 2 else material.specular
    body = material.diffuse
    if material.image is not None:
        # A hundredth of a picture may be highlights and noise.
        body = np.quantile(material.image.reshape(-1, len(body)), 0.99, axis=0)
    most = float((body + gloss).max())
    if most > 1.0 + _ROOM:
        table.wrong(
            "",
            f"a surface that returns {most:.2f} of the light: body {float(np.max(body)):.2f} and "
            f"gloss {float(np.max(gloss)):.2f}",
            "at most 1 together",
            "lower diffuse or specular",
        )


def _angles() -> NDArray[np.float64]:
    return np.arccos(np.linspace(1.0, 0.0, ANGLES))


def _chart():
    return sets.surfaces("colorchecker24")
